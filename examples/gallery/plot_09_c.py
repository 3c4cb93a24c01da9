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

import matplotlib.pyplot as plt
import numpy as np

import truejoint
from truejoint.export import export_c
from truejoint.motion import follow, random_motion, zigzag
from truejoint.recordings import Recorder

arm = truejoint.crtk.simulated_arm("raven2", seed=1)
arm.enable()
arm.home()


def record(trajectory):
    """Follow a trajectory and keep the arm's state, with the joints' true positions."""
    with Recorder(arm, state_rate=30.0) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


model = truejoint.calibrate(record(zigzag(arm.robot, "J1-J2-J3", 0.5)), "linear")
test = record(random_motion(arm.robot, 60.0, seed=3))

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

# %%
# Run it
# ------
# A main of a few lines reads samples, as a controller reads them from its bus. The same samples go
# through the Python corrector.

MAIN = """
#include <stdio.h>
#include "{prefix}.h"
int main(void)
{{
    static {prefix}_state state;
    double t, sample[{NAME}_SIGNALS], position[{NAME}_JOINTS], half_width[{NAME}_JOINTS];
    {prefix}_init(&state);
    {prefix}_set_homing(&state, 1, {NAME}_HOMING_OF_CALIBRATION);
    while (scanf("%lf", &t) == 1) {{
        for (int k = 0; k < {NAME}_SIGNALS; k++)
            if (scanf("%lf", &sample[k]) != 1) return 1;
        {prefix}_step(&state, t, sample, position, half_width);
        printf("%.17g\\n", position[{NAME}_JOINT_ELBOW]);
    }}
    return 0;
}}
"""

corrector = truejoint.Corrector(model)
corrector.set_homing(True, test.provenance.homing_id)
joint = list(corrector.joints).index("elbow")
in_python = corrector.run(test).position[:, joint]
curves = {"reported": test["measured/elbow"], "Python": in_python}
if shutil.which("cc"):
    main = folder / "main.c"
    main.write_text(MAIN.format(prefix=prefix, NAME=prefix.upper()))
    program = folder / "loop"
    subprocess.run(["cc", "-std=c99", "-O2", main, sources[0], "-lm", "-o", program], check=True)
    np.savetxt(folder / "samples.txt", test.table[["t", *corrector.signals]], "%.17g")
    with (folder / "samples.txt").open() as samples:
        said = subprocess.run([program], stdin=samples, capture_output=True, text=True, check=True)
    curves["C"] = np.array(said.stdout.split(), float)
    print("largest difference [rad]:", np.abs(curves["C"] - in_python).max())

figure, axes = plt.subplots(figsize=(8, 3.2), layout="constrained")
for (name, position), style in zip(curves.items(), ("-", "-", "--"), strict=False):
    axes.plot(test.t, np.degrees(position - test["truth/elbow"]), style, label=name)
axes.set(xlabel="time [s]", ylabel="error of the elbow [deg]")
axes.legend()
plt.show()
