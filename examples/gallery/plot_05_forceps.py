"""
Cable-driven forceps: the paper's filter and gated plays
========================================================

yan2020 estimates the angle of a jaw from its motor and an encoder on the reset cable. Its filter is
good without a load. Gated plays stay good under one.
"""

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies.forceps.methods import record

# %%
# Calibrate without a load
# ------------------------
# A is a virtual specimen that was selected by the paper's own figures.

forceps = specimen("A")
training = record(forceps, "nested", seed=0)
test = record(forceps, "verification", seed=1)
names = {
    "lsm": "least squares (29)",
    "ukf_compensated": "unscented filter, compensated (26)",
    "play_gated": "gated plays",
}
models = {name: truejoint.calibrate(training, name) for name in names}

# %%
# Judge on another motion
# -----------------------

settled = test.t > 2.2
figure, axis = plt.subplots(figsize=(9, 4.5))
for name, model in models.items():
    error = np.degrees(model.correct(test)[:, 0] - test.column("truth/jaw"))
    rms = np.sqrt(np.mean(error[settled] ** 2))
    axis.plot(test.t[settled], error[settled], linewidth=0.8, label=f"{names[name]}: {rms:.3f} deg")
axis.set_xlabel("time [s]")
axis.set_ylabel("error of the jaw [deg]")
axis.set_title("Trajectory (28), no load")
axis.legend(loc="upper right")
axis.grid(alpha=0.3)
plt.show()
