"""
Choose an estimator
===================

`-e auto` cross-validates the estimators and takes the one with the least expected error, or a mean.
Here it meets a joint with backlash whose width grows with the load.
"""

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.calibration import Automatic
from truejoint.recordings import Provenance, Recording

# %%
# Recordings
# ----------
# A CSV of yours would come from ``truejoint.read_recording("run.csv")``.


def run(seed):
    """Forty seconds of a jaw whose truth lags behind by a play that the effort widens."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 40.0, 0.02)
    measured = 0.5 * np.sin(rng.uniform(0.5, 1.2) * t) + 0.2 * np.sin(rng.uniform(1.5, 3.0) * t)
    effort = 0.5 + 0.5 * np.sin(rng.uniform(0.1, 0.3) * t + rng.uniform(0.0, 6.0))
    truth = np.empty_like(t)
    position = measured[0]
    for k, (motor, load) in enumerate(zip(measured, effort, strict=True)):
        position = np.clip(position, motor - 0.02 * (1 + load), motor + 0.02 * (1 + load))
        truth[k] = position
    columns = {"t": t, "measured/jaw": measured, "effort/jaw": effort, "truth/jaw": truth}
    where = Provenance("davinci_grasper", session=f"run {seed}")
    return Recording.from_columns(columns, where, {"effort/jaw": "Nm"})


training, test = [run(seed) for seed in range(5)], run(9)

# %%
# Choose
# ------
# The model keeps the table of what was tried.

chosen = truejoint.calibrate(training, Automatic(seconds=20.0))
for row in chosen.metadata["choice"]["tried"]:
    rmse = np.degrees(row.get("rmse", {}).get("jaw", np.nan))
    weight = row.get("weights", {}).get("jaw", 0.0)
    print(f"{row['estimator']:14} {rmse:6.3f} deg  weight {weight:.2f}  {row.get('note', '')}")

# %%
# Compare on a recording that the choice did not see
# --------------------------------------------------

truth = test.column("truth/jaw")
errors = {"raw": test.column("measured/jaw") - truth}
for name in ("offset", "linear", "poly2", "dnn"):
    errors[name] = truejoint.calibrate(training, name).correct(test)[:, 0] - truth
errors["auto"] = chosen.correct(test)[:, 0] - truth
rms = {name: np.degrees(np.sqrt(np.mean(error**2))) for name, error in errors.items()}
figure, axis = plt.subplots(figsize=(7, 4))
bars = axis.bar(list(rms), list(rms.values()))
axis.bar_label(bars, fmt="%.2f")
axis.set_ylabel("RMSE of the jaw [deg]")
plt.show()
