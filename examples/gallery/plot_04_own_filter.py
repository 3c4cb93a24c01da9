"""
An unscented filter for a model of yours
========================================

The filter takes any discrete model. You write two functions: how the state moves on, and what the
sensors see of it.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
from numba import njit

from truejoint.filters import StateSpaceModel, UnscentedFilter

# %%
# A pendulum
# ----------
# Its encoder shows the angle. The rate has no sensor.


@njit(error_model="numpy")
def swing(x, u, dt, parameters, out):
    """Move angle and rate on by `dt`."""
    out[0] = x[0] + dt * x[1]
    out[1] = x[1] + dt * (u[0] - parameters[0] * math.sin(x[0]))


@njit(error_model="numpy")
def encoder(x, u, parameters, out):
    """Angle, as the encoder shows it."""
    out[0] = x[0]


model = StateSpaceModel(
    transition=swing,
    measurement=encoder,
    process_noise=np.diag([0.0, 1e-6]),
    measurement_noise=[[1e-3]],
    states=("angle", "rate"),
    measurements=("angle",),
    inputs=("torque",),
    parameters=(9.81,),
    angles=("angle",),
)

# %%
# Measurements with faults
# ------------------------
# Half a second of the encoder is missing, and one reading is off by a full radian.

rng = np.random.default_rng(0)
t = np.arange(0.0, 4.0, 1e-2)
x = np.array([0.5, 0.0])
states = []
for _ in t:
    after = np.empty(2)
    swing(x, np.zeros(1), 1e-2, np.array([9.81]), after)
    x = after
    states.append(x)
states = np.array(states)
z = states[:, :1] + rng.normal(0.0, 0.03, (len(t), 1))
z[100:150] = np.nan
z[250] += 1.0

pendulum = UnscentedFilter(model, gate=0.999)
result = pendulum.run(z, np.zeros((len(t), 1)), x0=[0.4, 0.0], P0=np.diag([1e-2, 1e-2]), dt=1e-2)
smooth = pendulum.smooth(result)

# %%
# Rate, which no sensor shows
# ---------------------------

figure, axes = plt.subplots(2, sharex=True, figsize=(8, 6))
axes[0].plot(t, z[:, 0], ".", markersize=3, color="grey", label="encoder")
axes[0].plot(t, result.x[:, 0], label="filter")
axes[0].set_ylabel("angle [rad]")
axes[1].plot(t, states[:, 1], color="black", linewidth=1, label="true")
axes[1].plot(t, result.x[:, 1], label="filter")
axes[1].plot(t, smooth.x[:, 1], "--", label="smoother")
spread = 2.0 * np.sqrt(result.P[:, 1, 1])
axes[1].fill_between(t, result.x[:, 1] - spread, result.x[:, 1] + spread, alpha=0.2)
axes[1].set_ylabel("rate [rad/s]")
axes[1].set_xlabel("time [s]")
for axis in axes:
    axis.legend(loc="upper right")
    axis.grid(alpha=0.3)
plt.show()
