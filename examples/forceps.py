"""A cable-driven jaw: calibrate, verify, load and weigh it, cell by cell."""

# %% [markdown]
# # A cable-driven jaw, estimated from the drive unit
#
# A motor pulls a jaw open over half a metre of steel cable, a spring shuts it. The motor knows its
# own angle; the jaw is elsewhere: cables stretch, slide and jaw rub. yan2020 installs one encoder
# on the reset cable and asks an unscented filter. This script calibrates that filter and others on
# a virtual forceps, verifies them on another motion, hangs weights on the jaw, and weighs them.
#
# Run it as a script, or cell by cell in an editor that knows `# %%`.

# %%
from pathlib import Path

import numpy as np
from rich.console import Console

from truejoint import calibrate, read_calibration
from truejoint.evaluation.forceps import (
    compare_forces,
    compare_homing,
    compare_loaded,
    compare_strategies,
    compare_unloaded,
)
from truejoint.evaluation.forceps.figures import plot_loaded, plot_unloaded
from truejoint.evaluation.forceps.plant import record_motion
from truejoint.simulation.forceps_specimens import specimen

console = Console(width=140)
folder = Path("forceps-example")
folder.mkdir(exist_ok=True)

# %% [markdown]
# ## Calibrate, save, correct
# Two recordings, as a laboratory would have them: (27) to calibrate on, (28) to verify. The same
# two calls take any estimator, and would take a recording of a real jaw.

# %%
forceps = specimen("A")  # like the paper's, chosen on its numbers
calibration = record_motion(forceps, "calibration", specimen="A", seed=0)
verification = record_motion(forceps, "verification", specimen="A", seed=1)
settled = verification.t > 2.2
for name in ("ukf_compensated", "play_gated", "ukf_friction"):
    model = calibrate(calibration, name)
    model.save(folder / f"{name}.safetensors", overwrite=True)
    error = model.correct(verification)[:, 0] - verification.column("truth/jaw")
    console.print(f"{name}: {np.degrees(np.sqrt(np.mean(error[settled] ** 2))):.3f} deg RMS")

# %% [markdown]
# ## In a loop
# One sample at a time gives the same numbers to the last bit.

# %%
model = read_calibration(folder / "play_gated.safetensors")
state = model.start()
samples = np.column_stack([verification.column(name) for name in model.signals])
online = [model.step(state, t, s) for t, s in zip(verification.t[:500], samples, strict=False)]
console.print("same bits:", np.array_equal(online, model.correct(verification)[:500]))

# %% [markdown]
# ## Table 2, beside the paper's numbers

# %%
table_2 = compare_unloaded(forceps, specimen="A")
console.print(table_2.table().rich())
plot_unloaded(table_2, folder / "table2.png")

# %% [markdown]
# ## Table 3: weights on the jaw
# What the paper's compensation learnt holds without a load. Along the motion it is off by degrees;
# an estimate that leans on the reset cable hardly notices.

# %%
table_3 = compare_loaded(forceps, specimen="A")
console.print(table_3.table().rich())
plot_loaded(table_3, folder / "table3.png")

# %% [markdown]
# ## Which sensor is worth its place?
# Change a stiffness, a friction or a radius and ask again.

# %%
stiffer = forceps.with_values({"drive_cable.stiffness": 16e3, "reset_cable.stiffness": 16e3})
for name, parameters in {"A": forceps, "A, stiffer cables": stiffer}.items():
    console.print(compare_strategies(parameters, specimen=name).table().rich())

# %% [markdown]
# ## The load itself, and the zero after homing

# %%
console.print(compare_forces(forceps, specimen="A").table().rich())
console.print(compare_homing(forceps, specimen="A").table().rich())
