"""The compensator in C: the bits of the Python, whatever the stream."""

import ctypes
import re
import subprocess

import numpy as np
import pytest
from tests.runtime.streams import faulty

from truejoint.errors import ExportError
from truejoint.estimators import Polynomial
from truejoint.export.export_c import check_command, export_c
from truejoint.robots import get_robot
from truejoint.runtime import Compensator, Corrector, Status

from .export_models import HISTORY, PLAIN, calibration, columns, recording
from .library import COMPILER, FLAGS, SAME_BITS, compile_c, needs_compiler

HOW = {"rate": 100.0, "lag": 0.05, "believed": Status.OUT_OF_DOMAIN}
RUN = """
#include "m_compensator.h"
static m_state state;
static m_compensator compensator;
void run(int n, const double *t, const {real} *sample, const double *wanted, const double *start,
    double *setpoint, int *status);
void run(int n, const double *t, const {real} *sample, const double *wanted, const double *start,
    double *setpoint, int *status)
{{
    m_init(&state);
    m_set_homing(&state, 1, M_HOMING_OF_CALIBRATION);
    m_compensator_start(&compensator, start);
    for (int i = 0; i < n; i++) {{
        status[i] = m_compensate(&compensator, &state, t[i], sample + i * M_SIGNALS,
            wanted + i * M_JOINTS, setpoint + i * M_JOINTS);
    }}
}}
"""


def around(model, **how) -> Compensator:
    """A loop around a model of the arm, homed as the model wants it."""
    corrector = Corrector(model.without_redundant())
    corrector.set_homing(True, "h1")
    return Compensator(corrector, get_robot("raven2", "left"), **HOW | how)


def stream(compensator: Compensator, seed: int = 5):
    """Stamps, samples with faults, and wanted positions that also stand still or are no number."""
    rng = np.random.default_rng(seed)
    signals = list(compensator.corrector.signals)
    training = recording(columns(HISTORY, compensator.corrector.joints))
    t, samples = faulty(training.t, training.table[signals].to_numpy(), seed)
    wanted = training.table[signals].to_numpy()[:, compensator.measured] + 0.01
    t[-200:], samples[-200:] = training.t[-200:], training.table[signals].to_numpy()[-200:]
    samples[-300:-200] = np.nan  # for a second of the loop
    wanted[200:260] = wanted[199]
    wanted[rng.choice(len(t), 20), 0] = np.nan
    return t, samples, wanted


@needs_compiler
@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_broken_stream_gives_the_same_set_points(tmp_path, precision):
    model = calibration(Polynomial(1), HISTORY)
    how = {"gain": 0.4, "time_constant": 0.06} if precision == "float" else {"dead_band": 0.002}
    compensator = around(model, **how)
    paths = export_c(model, tmp_path, prefix="m", precision=precision, compensator=compensator)
    check = (tmp_path / "m_check.c").read_text()
    (allowed,) = re.findall(r"double setpoint_tolerance\[M_JOINTS\] = \{([^}]*)\}", check)
    assert max(map(float, allowed.split(","))) < 1e-4, "it could not fail"
    (tmp_path / "run.c").write_text(RUN.format(real=precision))
    sources = [tmp_path / name for name in ("m.c", "m_compensator.c", "run.c")]
    compile_c(sources, tmp_path / "run.so", *FLAGS, *SAME_BITS)
    subprocess.run(  # noqa: S602  # our own
        check_command(paths).replace("cc ", f"{COMPILER} ", 1), shell=True, check=True, cwd=tmp_path
    )
    t, samples, wanted = stream(compensator)
    samples = np.ascontiguousarray(samples, np.float32 if precision == "float" else np.float64)
    start, n = samples[0, compensator.measured].astype(float), len(t)
    setpoint, status = np.empty(wanted.shape), np.empty(n, dtype=np.int32)
    given = (t, samples, np.ascontiguousarray(wanted), start, setpoint, status)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in given]
    ctypes.CDLL(str(tmp_path / "run.so")).run(n, *pointers)
    compensator.start(start)
    falls_back = []
    for k in range(n):
        expected = compensator.step(t[k], samples[k].astype(float), wanted[k])
        falls_back.append(compensator.falls_back)
        if precision == "double":
            assert status[k] == compensator.status
            np.testing.assert_array_equal(setpoint[k], expected, err_msg=f"step {k}")
    assert set(np.diff(np.array(falls_back, dtype=int))) == {-1, 0, 1}  # and back again
    assert 0.2 < (status & ~int(Status.OUT_OF_DOMAIN) == 0).mean() < 1.0
    np.testing.assert_allclose(setpoint[-1], compensator.setpoint, atol=1e-3)


def test_a_loop_around_another_model_is_refused(tmp_path):
    other = around(calibration(Polynomial(1), HISTORY))
    with pytest.raises(ExportError, match="make it around this one"):
        export_c(calibration(Polynomial(1), PLAIN), tmp_path, compensator=other)
