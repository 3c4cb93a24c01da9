"""The check that goes with an exported source fails when any number of the source is wrong."""

import ctypes
import re
from pathlib import Path

import numpy as np
import pytest

from truejoint.estimators import Polynomial
from truejoint.export.export_c import export_c

from ..runtime.registered import model
from .export_models import HISTORY, calibration
from .library import compile_c, needs_compiler, unhurried

KINDS = {"double": ctypes.c_double, "float": ctypes.c_float, "int": ctypes.c_int}
CONSTANT = re.compile(r"^static const (double|float|int) (\w+)(?:\[(\d+)\])? = ", re.MULTILINE)


class Source:
    """An exported source whose numbers can be changed, with its check and its digest."""

    def __init__(self, folder: Path, calibration, precision: str, *, digest: bool = True) -> None:
        export_c(calibration, folder, prefix="m", precision=precision)
        text = (folder / "m.c").read_text()
        constants = CONSTANT.findall(text)
        text = CONSTANT.sub(lambda m: m[0].replace("static const", "static"), text)
        cases = "".join(
            f"case {k}: return (void *){'' if size else '&'}{name}; "
            for k, (_, name, size) in enumerate(constants)
        )
        text += f"void *place(int k) {{ switch (k) {{ {cases} default: return 0; }} }}\n"
        text += "#include <stdio.h>\n#define printf(...) (void)0\n#define main check\n"
        check = unhurried(folder)
        assert "m_digest() != M_DIGEST" in check
        text += check if digest else check.replace("m_digest() != M_DIGEST", "0")
        (folder / "open.c").write_text(text)
        library = folder / "open.so"
        compile_c([folder / "open.c"], library, "-shared", "-fPIC", "-O1")
        functions = ctypes.CDLL(str(library))
        self.is_wrong = lambda: bool(functions.check())
        functions.place.restype = ctypes.c_void_p
        self.digest = functions.m_digest
        self.digest.restype = ctypes.c_ulonglong
        self.numbers = {
            name.removeprefix("m_"): np.ctypeslib.as_array(
                ctypes.cast(functions.place(k), ctypes.POINTER(KINDS[kind])), (int(size or 1),)
            )
            for k, (kind, name, size) in enumerate(constants)
        }


@needs_compiler
@pytest.mark.parametrize(
    ("name", "precision"),
    [("rich_trees", "double"), ("gp", "float"), ("ukf_compensated", "double")],
)
def test_every_number_that_is_wrong_is_noticed(tmp_path, name, precision):
    """Learnt numbers, thresholds and leaves of trees, limits, and where things are."""
    source = Source(tmp_path, model(name), precision)
    digest = source.digest()
    assert not source.is_wrong()
    for table in source.numbers.values():
        for i in np.flatnonzero(np.isfinite(table)):
            right = table[i]
            is_whole = table.dtype == np.int32
            table[i] = right + 1 if is_whole else right * (1.0 + 1e-4) + (right == 0)
            assert source.digest() != digest
            table[i] = right
    table[i] += 1
    assert source.is_wrong()


@needs_compiler
def test_samples_alone_notice_tables_of_limits_that_are_wrong(tmp_path):
    """As where numbers are right, and used otherwise: no digest sees that."""
    source = Source(
        tmp_path, calibration(Polynomial(1), HISTORY, rezero=0.0), "double", digest=False
    )
    rest = {"jump", "correction_lower", "correction_upper"}  # no sample of its own comes near
    for name, table in source.numbers.items():
        if name in rest or len(table) == 1 or table.dtype == np.int32:
            continue
        right, noticed = table.copy(), False
        for factor in (0.7, 1.4):
            table[:] = factor * right
            noticed |= source.is_wrong()
            table[:] = right
        assert noticed, name
