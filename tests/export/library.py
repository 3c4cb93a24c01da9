"""Exported calibrations, compiled and called."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from tests.runtime.streams import run

from truejoint.export.export_c import export_c

COMPILER = shutil.which("gcc") or shutil.which("clang") or shutil.which("cc")
CPP = shutil.which("g++") or shutil.which("clang++")
STRICT = ("-Wall", "-Wextra", "-Wshadow", "-Werror", "-pedantic")
FLAGS = ("-std=c99", *STRICT, "-shared", "-fPIC")
SAME_BITS = ("-O1", "-ffp-contract=off")
PLAIN = ("-O0", "-ffp-contract=off")  # the same bits, compiled in half the time
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")

ACKNOWLEDGED = 30
"""Every how many samples somebody says that the zero is right: faults would leave little else."""

# The generated check as a function, and a loop over many samples, in one library.
BRIDGE = """
#define ACKNOWLEDGED {acknowledged}
#define main check
{check}
#undef main
int check(void);
void start(void);
void forget_all(void);
unsigned long ram(void);
unsigned long ram(void) {{ return sizeof(m_state); }}
static m_state kept;
void start(void) {{ m_init(&kept); m_set_homing(&kept, 1, M_HOMING_OF_CALIBRATION); }}
void forget_all(void) {{ m_reset(&kept); }}
void run(int n, const double *t, const {real} *sample, int *status, {real} *position,
    {real} *half_width, {real} *correction);
void run(int n, const double *t, const {real} *sample, int *status, {real} *position,
    {real} *half_width, {real} *correction)
{{
    for (int i = 0; i < n; i++) {{
        if (i % ACKNOWLEDGED == 0) {{
            m_acknowledge(&kept);
        }}
        status[i] = m_step(&kept, t[i], sample + i * M_SIGNALS, position + i * M_JOINTS,
            half_width + i * M_JOINTS);
        for (int j = 0; j < M_JOINTS; j++) {{
            correction[i * M_JOINTS + j] = kept.correction[j];
        }}
    }}
}}
"""


class Library:
    """An exported calibration, compiled."""

    def __init__(self, folder: Path, precision: str = "double", flags=PLAIN) -> None:
        (folder / "bridge.c").write_text(
            BRIDGE.format(real=precision, acknowledged=ACKNOWLEDGED, check=unhurried(folder)),
            encoding="ascii",
        )
        path = folder / f"library{len(list(folder.glob('*.so')))}.so"
        compile_c([folder / "m.c", folder / "bridge.c"], path, *FLAGS, *flags)
        self.functions = ctypes.CDLL(str(path))
        self.dtype = np.dtype(np.float64 if precision == "double" else np.float32)
        self.folder = folder

    def run(self, t, samples, n_joints: int):
        """Status (n,), position, half-width, correction (n, n_joints) of samples (n, n_signals)."""
        n = len(t)
        t, samples = np.ascontiguousarray(t), np.ascontiguousarray(samples, dtype=self.dtype)
        status = np.empty(n, dtype=np.int32)
        outputs = np.empty((3, n, n_joints), dtype=self.dtype)
        arrays = (t, samples, status, *outputs)
        self.functions.run(n, *(a.ctypes.data_as(ctypes.c_void_p) for a in arrays))
        return status, *outputs


def unhurried(folder: Path) -> str:
    """Generated check, which does not time the ten rounds after it."""
    text = (folder / "m_check.c").read_text()
    assert "turn < 10;" in text
    return text.replace("turn < 10;", "turn < 0;")


def compile_c(sources, target, *flags: str) -> None:
    """Compile without a warning."""
    command = [COMPILER, *flags, *map(str, sources), "-lm", "-o", str(target)]
    subprocess.run(command, check=True)  # noqa: S603  # our own


def exported(folder: Path, model, precision: str = "double", flags=PLAIN, **options) -> Library:
    """Export a calibration as ``m`` and compile it."""
    export_c(model, folder, prefix="m", precision=precision, overwrite=True, **options)
    return Library(folder, precision, flags)


def good_rows(library: Library, calibration, recording) -> int:
    """Run a recording in C and count the good samples: each has the bits of its corrected row."""
    assert library.functions.check() == 0
    library.functions.start()
    samples = recording.table[list(calibration.loop_signals)].to_numpy()
    status, position, *_ = library.run(np.array(recording.t), samples, len(calibration.joints))
    good = status == 0
    np.testing.assert_array_equal(position[good], calibration.correct(recording)[good])
    return int(good.sum())


def expected(corrector, t, samples):
    """What a corrector gives, as `Library.run` does."""
    return run(corrector, t, samples, lambda row: row % ACKNOWLEDGED or corrector.acknowledge())
