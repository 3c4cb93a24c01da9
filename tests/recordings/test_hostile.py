"""Whatever a file is made to cost its reader, each command ends soon, in one line or a result.

All kinds with all commands: ``python -m tests.recordings.hostile``.
"""

import json
import subprocess
import sys

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")

from tests.recordings.hostile import BAGS, KINDS, LONGEST, MEMORY, SOON, STOPPED, attempts

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


@pytest.fixture(scope="module")
def tried() -> dict[tuple[str, str], dict]:
    """What became of each attempt."""
    line = [sys.executable, "-m", "tests.recordings.hostile", "--some"]
    done = subprocess.run(line, capture_output=True, text=True, check=True)  # noqa: S603
    results = map(json.loads, done.stdout.splitlines())
    return {(result["kind"], result["command"]): result for result in results}


def test_there_are_twenty_kinds_of_bags():
    assert sum(name.endswith(BAGS) for name in KINDS) >= 20
    assert {command for _, command in attempts(some=True)} >= {"extract", "doctor", "calibrate"}


@pytest.mark.parametrize(("kind", "command"), attempts(some=True))
def test_it_ends_soon_and_says_why(tried, kind, command):
    result = tried[kind, command]
    assert result["took"] < (SOON if command == STOPPED else LONGEST)
    assert result["memory"] < MEMORY
    assert result["code"] in ((130,) if command == STOPPED else (0, 1, 2))
    if result["code"] in (2, 130):
        last = result["said"][-1]
        assert last.startswith("truejoint: ")
        assert sum(line.startswith("truejoint: ") for line in result["said"]) == 1
    assert not any("Traceback" in line for line in result["said"])
