"""
A real da Vinci grasper
=======================

The MRDLab's recordings have a sensor on the jaw. The motor lies behind a metre of cable, so the
reported angle is off by degrees. The recordings are public: ``truejoint datasets
davinci_grasper_umn --fetch``.
"""

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.errors import TruejointError
from truejoint.evaluation.evaluate import split_sides
from truejoint.recordings import datasets

# %%
# Whole recordings are held out
# -----------------------------
# The training holds other frequencies than the test.

grasper = datasets.DATASETS["davinci_grasper_umn"]
split = grasper.split("frequency")
try:
    recordings = datasets.read_dataset(grasper.name, split.files)
except TruejointError as error:
    recordings = ()
    print("skipped:", error)

if recordings:
    training, test = split_sides(recordings, grasper, split)
    model = truejoint.calibrate(training, "rich_play")
    truth = np.degrees(test[0].column("truth/jaw"))
    figure, axis = plt.subplots(figsize=(6, 6))
    axis.plot(np.degrees(test[0].column("measured/jaw")), truth, label="reported")
    axis.plot(np.degrees(model.correct(test[0])[:, 0]), truth, label="corrected")
    axis.set_xlabel("jaw as reported or corrected [deg]")
    axis.set_ylabel("true jaw [deg]")
    axis.legend()
    axis.grid(alpha=0.3)
    plt.show()
