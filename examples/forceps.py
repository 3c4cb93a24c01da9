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

from truejoint import calibrate, read_calibration, write_calibration
from truejoint.runtime import Corrector, Status
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies import run_study, write_study
from truejoint.studies.forceps.methods import record

console = Console(width=140)
folder = Path("forceps-example")
folder.mkdir(exist_ok=True)

# %% [markdown]
# ## Calibrate, save, correct
# Two recordings, as a laboratory would have them: one minute of loops of three sizes to calibrate
# on, (28) to verify. The same two calls take any estimator, and would take a recording of a real
# jaw; `truejoint trajectory nested` makes the motion for one.

# %%
forceps = specimen("A")  # like the paper's, chosen on its numbers
calibration = record(forceps, "nested", seed=0)
verification = record(forceps, "verification", seed=1)
settled = verification.t > 2.2
for name in ("ukf_compensated", "play_gated", "ukf_friction"):
    model = calibrate(calibration, name)
    write_calibration(model, folder / f"{name}.safetensors", overwrite=True)
    error = model.correct(verification)[:, 0] - verification.column("truth/jaw")
    console.print(f"{name}: {np.degrees(np.sqrt(np.mean(error[settled] ** 2))):.3f} deg RMS")

# %% [markdown]
# ## In a loop
# One sample at a time gives the same numbers to the last bit.

# %%
model = read_calibration(folder / "play_gated.safetensors")
corrector = Corrector(model)
corrector.set_homing(True)
trace = corrector.run(verification)
good = trace.status == Status(0)
online, offline = trace.position[good], model.correct(verification)[good]
console.print(f"same bits in {good.sum()} rows:", np.array_equal(online, offline))

# %% [markdown]
# ## Table 2, beside the paper's numbers
# A study makes tables, figures and a verdict on each of the paper's claims. `truejoint study` does
# the same from the command line, on all cores, and keeps the parts that are done.


# %%
def show(name: str, **options: object) -> None:
    """Run a study, print its tables, and leave its page in the folder."""
    result = run_study(name, options, folder=folder / name)
    for table in result.summary.tables:
        console.print(table.rich())
    console.print(write_study(result, folder / name, overwrite=True)[0])


show("forceps-unloaded")

# %% [markdown]
# ## Table 3: weights on the jaw
# What the paper's compensation learnt holds without a load. Along the motion it is off by degrees;
# an estimate that leans on the reset cable hardly notices.

# %%
show("forceps-loaded")

# %% [markdown]
# ## Which sensor is worth its place?
# Change a stiffness, a friction or a radius and ask again.

# %%
stiffer = folder / "stiffer.toml"
stiffer.write_text("[drive_cable]\nstiffness = 16e3\n[reset_cable]\nstiffness = 16e3\n")
for name in ("nominal", stiffer):
    show("forceps-strategies", specimen=name)

# %% [markdown]
# ## The load itself

# %%
show("forceps-load")
