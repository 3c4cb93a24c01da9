"""
A model in C
============

`export_c` writes a calibration as C99 that needs `math.h` alone. Its own check compares it with
Python on samples with every kind of fault.
"""

import shutil
import subprocess
from pathlib import Path
from tempfile import mkdtemp

import truejoint
from truejoint.export import export_c
from truejoint.motion import follow, zigzag
from truejoint.recordings import Recorder

arm = truejoint.crtk.simulated_arm("raven2", seed=1)
arm.enable()
arm.home()
with Recorder(arm, state_rate=30.0) as recorder:
    follow(arm, zigzag(arm.robot, "J1-J2-J3", 0.5))
model = truejoint.calibrate(recorder.recording(), "linear")

# %%
# Export
# ------

folder = Path(mkdtemp())
export_c(model, folder)
for path in sorted(folder.iterdir()):
    print(f"{path.name}: {len(path.read_text().splitlines())} lines")

# %%
# The interface
# -------------

header = next(folder.glob("*left.h")).read_text()
print(header[:1500])

# %%
# Compile and check
# -----------------
# Do this on the machine and with the compiler that will run it.

if shutil.which("cc"):
    prefix = next(folder.glob("*_check.c")).stem.removesuffix("_check")
    program = folder / "check"
    sources = [folder / f"{prefix}.c", folder / f"{prefix}_check.c"]
    subprocess.run(["cc", "-std=c99", "-O2", *sources, "-lm", "-o", program], check=True)
    print(subprocess.run([program], capture_output=True, text=True, check=True).stdout)
else:
    print("skipped: no C compiler here")
