"""The command answers at once: nothing heavy is imported to say what there is."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

HEAVY = {"matplotlib", "numba", "numpy", "pandas", "plotly", "pyarrow", "scipy", "sklearn"}
PROGRAM = """
import sys
from truejoint.cli.app import main
try:
    main()
finally:
    print(*sorted({name.partition(".")[0] for name in sys.modules}), file=sys.stderr)
"""


def imported(*words: str, **environment: str) -> set[str]:
    """Packages that a call of the command imports."""
    result = subprocess.run(  # noqa: S603  # our own program
        [sys.executable, "-c", PROGRAM, *words],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    return set(result.stderr.split())


def test_help_imports_nothing_heavy():
    assert not HEAVY & imported("--help")


@pytest.mark.parametrize(
    "words",
    [
        "truejoint ",
        "truejoint calibrate -e ",
        "truejoint calibrate --format ",
        "truejoint calibrate --set ",
        "truejoint collect --robot ",
        "truejoint collect --arm ",
        "truejoint trajectory zigzag --direction ",
    ],
)
def test_completion_imports_nothing_heavy(words):
    number = str(len(words.split()))
    environment = {"COMP_WORDS": words, "COMP_CWORD": number}
    environment["_TRUEJOINT_COMPLETE"] = "complete_bash"
    assert not HEAVY & imported(**environment)
