"""The check that goes with an exported source fails when the source is wrong."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import numpy as np
import pytest

from truejoint.estimators import NeuralNetwork, Polynomial
from truejoint.export.export_c import export_c

from .export_models import HISTORY, calibration
from .library import compile_c, needs_compiler

LEARNT = [
    "mean",
    "inverse_scale",
    "coef",
    "intercept",
    "target_mean",
    "target_scale",
    "biases",
    "weights",
]
LEARNT = {f"model_{name}" for name in LEARNT}

ESTIMATORS = Polynomial(1), Polynomial(2), NeuralNetwork(hidden_layer_sizes=(9, 7))


class Source:
    """An exported source whose tables of numbers can be changed, with its check."""

    def __init__(self, folder: Path, model, precision: str) -> None:
        export_c(model, folder, prefix="m", precision=precision)
        text = (folder / "m.c").read_text()
        found = re.findall(rf"^static const {precision} (\w+)\[(\d+)\] = ", text, re.MULTILINE)
        text = re.sub(
            rf"^static const {precision} (\w+)\[",
            rf"static {precision} \1[",
            text,
            flags=re.MULTILINE,
        )
        cases = "".join(f"case {k}: return {name}; " for k, (name, _) in enumerate(found))
        text += f"void *table(int k) {{ switch (k) {{ {cases} default: return 0; }} }}\n"
        text += "#include <stdio.h>\n#define printf(...) (void)0\n#define main check\n"
        text += '#include "m_check.c"\n'
        (folder / "open.c").write_text(text)
        library = folder / "open.so"
        compile_c([folder / "open.c"], library, "-shared", "-fPIC", "-O1")
        functions = ctypes.CDLL(str(library))
        self.wrong = lambda: bool(functions.check())
        functions.table.restype = ctypes.POINTER(
            ctypes.c_double if precision == "double" else ctypes.c_float
        )
        self.tables = {
            name.removeprefix("m_"): np.ctypeslib.as_array(functions.table(k), (int(size),))
            for k, (name, size) in enumerate(found)
        }


def kept(table):
    """Index of each number that is more than filling."""
    return np.flatnonzero(np.isfinite(table) & (table != 0.0))


def unnoticed(source: Source, table, factor: float) -> int:
    """How many numbers of a table may each be wrong by a factor without the check failing."""
    right, missed = table.copy(), 0
    for i in np.flatnonzero(np.isfinite(right) & (right != 0.0)):
        table[i] *= factor
        missed += not source.wrong()
        table[i] = right[i]
    return missed


@needs_compiler
@pytest.mark.parametrize(("precision", "factor"), [("double", 1.0001), ("float", 1.1)])
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=str)
def test_every_learnt_number_that_is_wrong_is_noticed(tmp_path, estimator, precision, factor):
    source = Source(tmp_path, calibration(estimator, HISTORY, rezero=0.0), precision)
    assert not source.wrong()
    assert len(LEARNT & source.tables.keys()) >= 4
    for name in LEARNT & source.tables.keys():
        table = source.tables[name]
        hidden = max(1.0, 0.1 * len(table)) if precision == "float" else 0  # hardly matter
        assert unnoticed(source, table, factor) <= hidden, name
    assert not source.wrong()


@needs_compiler
def test_every_table_of_limits_that_is_wrong_is_noticed(tmp_path):
    source = Source(tmp_path, calibration(Polynomial(1), HISTORY, rezero=0.0), "float")
    rest = {"jump", "correction_lower", "correction_upper"}  # no sample of its own comes near
    for name in source.tables.keys() - LEARNT - rest:
        table = source.tables[name]
        right = table.copy()
        noticed = False
        for factor in (0.7, 1.4):
            table *= factor
            noticed |= source.wrong()
            table[:] = right
        assert noticed, name
