"""The exported C under address and undefined-behaviour sanitizers, on any input at all."""

import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from truejoint.export.export_c import export_c

from ..runtime.registered import in_loop, model
from .library import STRICT

HARNESS = Path(__file__).with_name("fuzz.c")
SANITIZE = ("-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
MINUTES = float(os.environ.get("FUZZ_MINUTES", "0"))
SAMPLES = int(10_000 + 1e5 * MINUTES)
SOURCES = [
    (name, precision, compiler)
    for name in in_loop() for precision in ("double", "float") for compiler in ("gcc", "clang")
]  # fmt: skip
QUICK = [("lsm_compensated", "double", "clang"), ("ukf_friction", "float", "gcc")]


@cache
def why_not(compiler: str) -> str:
    """Why a compiler cannot make programs that check themselves; empty if it can."""
    if shutil.which(compiler) is None:
        return f"no {compiler} on this machine"
    test = [compiler, *SANITIZE, "-x", "c", "-", "-o", os.devnull]
    main = b"int main(void) { return 0; }"
    made = subprocess.run(test, input=main, capture_output=True, check=False)  # noqa: S603
    return f"{compiler} has no sanitizers here" if made.returncode else ""


@pytest.mark.parametrize(("name", "precision", "compiler"), SOURCES if MINUTES else QUICK)
def test_nothing_leads_the_source_astray(tmp_path, compiler, name, precision):
    if reason := why_not(compiler):
        pytest.skip(reason)
    export_c(model(name), tmp_path, prefix="m", precision=precision, on_fault="raw")
    program = tmp_path / "fuzz"
    flags = ("-std=c99", "-O1", *STRICT, *SANITIZE, f"-DREAL={precision}", f"-I{tmp_path}")
    command = [compiler, *flags, str(tmp_path / "m.c"), str(HARNESS), "-lm", "-o", str(program)]
    subprocess.run(command, check=True)  # noqa: S603  # our own
    for seed in range(2):
        words = [str(program), str(seed), str(SAMPLES)]
        run = subprocess.run(words, capture_output=True, text=True, check=False)  # noqa: S603
        assert run.returncode == 0, f"seed {seed}: {run.stdout}{run.stderr}"
