"""A late clock is one time at all speeds, a loop one distance."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from tests.recordings.judge.faults import named

from truejoint.recordings import Provenance, Recording, check_data
from truejoint.recordings.datasets.store import data_folders

RATE = 50.0  # Hz


def _play(motor: np.ndarray, half: float) -> np.ndarray:
    joint, place = np.empty_like(motor), motor[0]
    for row, value in enumerate(motor):
        place = joint[row] = min(max(place, value - half), value + half)
    return joint


def _recordings(frequencies: Sequence[float], late: float, half: float) -> list[Recording]:
    """A minute of a sine at each frequency [Hz]; a play, a slope and a bend; a late clock."""
    recordings = []
    fine = np.arange(-200, 4 * 60 * int(RATE)) / RATE / 4
    t = np.arange(60 * int(RATE)) / RATE
    for seed, frequency in enumerate(frequencies):
        rng = np.random.default_rng(seed)
        motor = 0.5 * np.sin(2 * np.pi * frequency * fine + rng.uniform(0, 6))
        truth = 0.95 * _play(motor, half) + 0.02 * motor**2
        columns = {
            "t": t,
            "measured/bend": np.interp(t, fine, motor),
            "truth/bend": np.interp(t - late, fine, truth) + 1e-3 * rng.normal(size=len(t)),
        }
        recordings.append(
            Recording.from_columns(columns, Provenance("kflex", source=f"{seed}.csv"))
        )
    return recordings


@pytest.mark.parametrize(
    ("frequencies", "half"), [((0.1, 0.5), 0.0), ((0.3, 0.5), 0.1), ((0.05, 0.1, 0.5, 0.5), 0.05)]
)
def test_a_late_clock_is_a_failure_and_a_loop_alone_is_none(frequencies, half):
    assert not named(check_data(_recordings(frequencies, 0.0, half)), "delay")
    (finding,) = named(check_data(_recordings(frequencies, 0.05, half)), "delay")
    assert finding.level == "fail"
    assert finding.where == "truth/bend"
    assert float(finding.what.split()[3]) == pytest.approx(50.0, abs=3.0)
    assert "beside a loop of" in finding.what


@pytest.mark.parametrize(
    ("count", "late", "half"), [(1, 0.05, 0.0), (1, 0.0, 0.05), (3, 0.05, 0.05)]
)
def test_one_speed_cannot_tell_a_clock_from_a_loop(count, late, half):
    (finding,) = named(check_data(_recordings([0.5] * count, late, half)), "delay")
    assert finding.level == "warn"
    assert "one speed cannot tell a late clock from hysteresis" in finding.what
    assert finding.advice == "record the same motion at half the speed too"


def _tendon_finger(*names: str) -> list[Recording]:
    """Sines of a tendon finger of 0.1 to 3 Hz, or a skip where this machine has none."""
    for folder in data_folders():
        paths = [Path(folder) / "tendon_finger" / f"{name}.csv.gz" for name in names]
        if all(path.is_file() for path in paths):
            break
    else:
        pytest.skip("no tendon_finger on this machine (TRUEJOINT_DATA)")
    recordings = []
    for path in paths:
        table = pd.read_csv(path).filter(regex="^(t$|measured/|truth/|effort/)")
        columns = {str(name): table[name].to_numpy(dtype=float) for name in table}
        origin = Provenance("kflex", source=path.name)
        recordings.append(Recording.from_columns(columns, origin))
    return recordings


@pytest.mark.parametrize("more", [(), ("f015a", "f020")])
def test_the_loop_of_a_tendon_is_neither_a_late_clock_nor_a_moved_zero(more):
    check = check_data(_tendon_finger("f001", "f002", "f010", "f030", *more))
    assert not {"delay", "zero"} & set(check.failures)
