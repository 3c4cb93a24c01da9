"""The command answers at once: nothing heavy is imported to say what there is."""

import json
import os
import subprocess
import sys

HEAVY = {"matplotlib", "numba", "numpy", "pandas", "plotly", "pyarrow", "scipy", "sklearn"}
PROGRAM = """
import json
import os
import sys
from truejoint.cli.app import main
for environment in json.loads(sys.argv.pop()):
    os.environ |= environment
    try:
        main()
    except SystemExit:
        pass
    print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})), file=sys.stderr)
    print("next")
"""
OFFERED = {
    "truejoint eval": "evaluate",
    "truejoint calibrate --est": "--estimator",
    "truejoint export m.st --to ": "onnx",
}


def imported(*words: str, environments: list[dict[str, str]]) -> list[tuple[str, set[str]]]:
    """What the command says in each of these environments, and what is imported by then."""
    result = subprocess.run(  # noqa: S603  # our own program
        [sys.executable, "-c", PROGRAM, *words, json.dumps(environments)],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        check=True,
    )
    packages = map(set, map(json.loads, result.stderr.splitlines()))
    return list(zip(result.stdout.split("next\n")[:-1], packages, strict=True))


def test_help_imports_nothing_heavy():
    ((said, packages),) = imported("--help", environments=[{}])
    assert "calibrate" in said
    assert not HEAVY & packages


def test_completion_imports_nothing_heavy():
    complete = {"_TRUEJOINT_COMPLETE": "complete_bash"}
    environments = [
        {**complete, "COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1)}
        for line in OFFERED
    ]
    told = imported(environments=environments)
    for offered, (said, packages) in zip(OFFERED.values(), told, strict=True):
        assert not HEAVY & packages, offered
        assert offered in said.split()
