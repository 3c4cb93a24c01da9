"""The command answers at once: nothing heavy is imported to say what there is."""

import json
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


def test_help_and_completion_import_nothing_heavy():
    complete = {"_TRUEJOINT_COMPLETE": "complete_bash"}
    environments = [
        {**complete, "COMP_WORDS": line, "COMP_CWORD": str(len(line.split(" ")) - 1)}
        for line in OFFERED
    ]
    result = subprocess.run(  # noqa: S603  # our own program
        [sys.executable, "-c", PROGRAM, "--help", json.dumps([{}, *environments])],
        capture_output=True,
        text=True,
        check=True,
    )
    told = zip(result.stdout.split("next\n")[:-1], result.stderr.splitlines(), strict=True)
    for offered, (said, packages) in zip(["calibrate", *OFFERED.values()], told, strict=True):
        assert not HEAVY & {*json.loads(packages)}, offered
        assert offered in said.split()
