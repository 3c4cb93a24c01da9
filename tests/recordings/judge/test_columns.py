"""Single columns: clocks, wraps and jumps, missing truth, sensors that stand still."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from tests.recordings.judge.faults import added, changed, named, names, stuck

from truejoint.recordings import DataCheck, Provenance, Recording, check_data


def _jaw(truth: np.ndarray, measured: np.ndarray, step: float = 0.02) -> DataCheck:
    columns = {"t": step * np.arange(len(truth)), "measured/jaw": measured, "truth/jaw": truth}
    return check_data(Recording.from_columns(columns, "davinci_grasper"))


@pytest.fixture(scope="module")
def clean(recording_of: Callable[..., Recording]) -> Recording:
    return recording_of("davinci_grasper", seconds=60, load=0.5, homing_id="h1")


TURN = added(slice(700, None), 2 * np.pi)
UNEVEN = np.cumsum(np.where(np.arange(1800) % 3 == 0, 0.06, 0.02))


@pytest.mark.parametrize(
    ("faults", "name", "level", "said"),
    [
        ({"t": UNEVEN}, "clock", "warn", "time stamps in .*: 33 % .* half off the median of 20 ms"),
        ({"measured__jaw": TURN}, "wrap", "fail", "^measured/jaw in synthetic-0.csv: 1 whole turn"),
        ({"truth__jaw": TURN}, "wrap", "fail", "^truth/jaw in synthetic-0.csv: 1 whole turn"),
        ({"measured__jaw": added(slice(700, None), 1.0)}, "jump", "warn", "1 sudden jump,"),
        ({"truth__jaw": stuck(400, 600)}, "frozen", "fail", "^truth/jaw .* repeats one value"),
        (
            {"measured__jaw": stuck(400, 600)},
            "frozen",
            "fail",
            "^measured/jaw .* repeats one value",
        ),
        ({"truth__jaw": added(slice(1260, None), np.nan)}, "missing", "warn", "30 % of the rows"),
        ({"truth__jaw": added(slice(1260, None), np.nan)}, "missing", "warn", "stops 18.0 s befo"),
        ({"truth__jaw": added(slice(720, None), np.nan)}, "missing", "fail", "60 % of the rows"),
        (
            {"effort__jaw": np.full(1800, 0.5)},
            "constant",
            "warn",
            "^effort/jaw .* 0.5 in every row",
        ),
    ],
)
def test_a_fault_of_a_column_is_named(clean, faults, name, level, said):
    findings = named(check_data([changed(clean, **faults)]), name)
    assert [f.level for f in findings if re.search(said, f.text)] == [level]


def test_a_truth_that_is_the_measured_position_is_none():
    jaw = 0.5 + 0.3 * np.sin(0.03 * np.arange(900))
    (finding,) = named(_jaw(jaw, jaw), "missing")
    assert (finding.level, finding.what) == ("fail", "it is the measured position")
    assert not named(_jaw(added([7], 1e-6)(jaw.copy()), jaw), "missing")


def test_a_jump_of_the_truth_is_no_turn(clean):
    assert not names(check_data([changed(clean, truth__jaw=added(slice(700, None), 1.0))])) & {
        "jump",
        "wrap",
    }


def test_a_gap_is_found(clean):
    (finding,) = named(check_data([clean.rows(np.r_[:300, 360:1800])]), "gap")
    assert finding.level == "warn"
    assert finding.what.startswith("1 gap longer than 5 samples, up to 2.03 s")


def test_a_constant_signal_of_an_unused_channel_is_no_finding(recording_of):
    recording = recording_of("raven2")
    unused = dict.fromkeys(("measured/unused", "effort/unused"), 0.0)
    table, units = recording.table.assign(**unused), dict.fromkeys(unused, "1")
    check = check_data([Recording(table, {**recording.units, **units}, recording.provenance)])
    assert not named(check, "constant")


MEASURED = 0.5 * np.sin(0.7 * np.arange(3000) / 50) + 0.1 * np.sin(1.9 * np.arange(3000) / 50)


def test_a_saturated_sensor_is_found():
    check = _jaw(np.minimum(MEASURED, 0.4), MEASURED)
    (finding,) = named(check, "saturated")
    assert finding.level == "fail"
    assert finding.where.startswith("truth/jaw")
    first, behind = finding.rows[0]
    assert (MEASURED[first:behind] >= 0.4).all()


def test_a_sensor_that_stands_is_said_when_though_truth_is_missing_before():
    t = 0.02 * np.arange(3000)
    q = np.sin(t) + 0.3 * np.sin(2.7 * t)
    truth = q + 0.01
    truth[:1000], truth[2000:2300] = np.nan, truth[2000]
    (finding,) = named(_jaw(truth, q), "frozen")
    assert "for 6.0 s, from 40.0 s" in finding.what


@pytest.mark.parametrize(("setpoint", "load"), [(True, 0.0), (False, 0.2)])
def test_a_load_that_turns_a_standing_joint_is_no_saturation(setpoint, load):
    still = np.minimum.accumulate(np.append(np.linspace(0.5, 0.0, 600), np.zeros(600)))
    pushed = still - 0.2 * np.clip(np.arange(1200) / 200 - 4, 0.0, 1.0)
    columns = {"t": np.arange(1200) / 50, "measured/jaw": still, "truth/jaw": pushed}
    sent = {"setpoint/jaw": still} if setpoint else {}

    def found(extra: dict[str, np.ndarray], load: float) -> bool:
        origin = Provenance("davinci_grasper", load=load)
        check = check_data(Recording.from_columns({**columns, **extra}, origin))
        return "saturated" in names(check)

    assert not found(sent, load)
    assert found({}, 0.0), "the case shows nothing"
    assert found({"setpoint/jaw": pushed}, load), "a motor that was sent on"


def test_slack_or_a_coarse_encoder_is_no_saturation():
    """With play the joint stands at its end while the motor side turns back."""
    truth, place = np.empty(len(MEASURED)), 0.0
    for k, value in enumerate(MEASURED):
        place = min(max(place, value - 0.05), value + 0.05)
        truth[k] = place
    for joint in (truth, np.round(MEASURED / 0.01) * 0.01):
        assert "saturated" not in names(_jaw(joint, MEASURED))


@pytest.mark.parametrize(
    ("step", "suspected"), [(1e5, True), (100.0, True), (10.0, True), (0.01, False), (10.5, False)]
)
def test_stamps_in_milliseconds_are_suspected(step, suspected):
    assert ("rate" in names(_jaw(MEASURED[:500], MEASURED[:500], step))) == suspected


def test_stamps_scaled_to_milliseconds_are_whole_but_for_the_last_bit():
    scaled = np.arange(500) * 0.05 * 1000.0
    assert (np.diff(scaled) != np.round(np.diff(scaled))).any()
    columns = {"t": scaled, "measured/jaw": MEASURED[:500], "truth/jaw": MEASURED[:500]}
    check = check_data(Recording.from_columns(columns, "davinci_grasper"))
    assert "rate" in names(check)
