"""
From a ROS bag to corrected joint states
========================================

Bags are read without a ROS installation. The corrector then takes the messages one by one, as
`truejoint node correct` does.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recorder, bag_topics, diagnose, read_bag, write_bag
from truejoint.runtime import Corrector

# %%
# Bags of one session
# -------------------
# Here a simulated RAVEN-II writes them. Yours come from ``rosbag record``.

arm = truejoint.crtk.simulated_arm("raven2", seed=8)
arm.enable()
arm.home()
folder = Path(mkdtemp())
motions = {"zigzag": zigzag(arm.robot, "J1-J2-J3", 0.5), "random": random_motion(arm.robot, 60.0)}
for name, trajectory in motions.items():
    with Recorder(arm, state_rate=100.0) as recorder:
        follow(arm, trajectory)
    write_bag(recorder.recording(), folder / f"{name}.mcap")
for topic in bag_topics(folder / "zigzag.mcap"):
    print(topic)

# %%
# Read, check, calibrate
# ----------------------

training = read_bag(folder / "zigzag.mcap", robot="raven2")
test = read_bag(folder / "random.mcap", robot="raven2")
for finding in diagnose(training).findings[:4]:
    print(f"{finding.level}: {finding.what}")
model = truejoint.calibrate(training, "linear")

# %%
# One message at a time
# ---------------------

corrector = Corrector(model)
corrector.set_homing(True, test.provenance.homing_id)
samples = test.table[list(corrector.signals)].to_numpy()
positions = np.empty((len(samples), len(corrector.joints)))
for k, (t, sample) in enumerate(zip(test.t, samples, strict=True)):
    corrector.step(t, sample)
    positions[k] = corrector.position

truth = test.columns("truth", corrector.joints)
figure, axis = plt.subplots(figsize=(8, 4))
axis.plot(test.t - test.t[0], 1e3 * (positions[:, 2] - truth[:, 2]))
axis.set_xlabel("time [s]")
axis.set_ylabel("error of the insertion [mm]")
axis.grid(alpha=0.3)
plt.show()
