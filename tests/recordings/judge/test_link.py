"""The doctor tells each illness by its name, from a recording made ill in exactly those ways."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.recordings.judge.faults import (
    added,
    by_heading,
    changed,
    late,
    named,
    of_quantity,
    stuck,
)
from tests.recordings.refusals import refused

from truejoint.crtk import simulated_arm
from truejoint.motion import follow, random_motion
from truejoint.recordings import Recorder, Recording, check_data, diagnose
from truejoint.recordings.judge.finding import FINDINGS, HEADING_OF, HEADINGS
from truejoint.recordings.read.raven_csv import AMID
from truejoint.recordings.table.stream import BACK


def record(arm_name: str, seed: int) -> Recording:
    arm = simulated_arm("raven2", arm_name, seed=seed)
    arm.enable()
    arm.home()
    with Recorder(arm, state_rate=50.0) as recorder:
        follow(arm, random_motion(arm.robot, duration=40.0, seed=seed))
    recording = recorder.recording()
    return recording.with_truth(recording.joints_of("truth"))


@pytest.fixture(scope="module")
def healthy() -> Recording:
    return record("left", 1)


@pytest.fixture(scope="module")
def other() -> Recording:
    return record("right", 2)


def dropped(count: int, reason: str) -> Callable[[Recording], Recording]:
    def drop(recording: Recording) -> Recording:
        told = {**recording.provenance.dropped, reason: count}
        return replace(recording, provenance=replace(recording.provenance, dropped=told))

    return drop


def without_truth(recording: Recording, share: float) -> Recording:
    rows = slice(round(share * len(recording)))
    return of_quantity(recording, "truth", added(rows, np.nan))


Illnesses = dict[str, tuple[Callable[[Recording], Recording], str]]
ILLNESSES: list[Illnesses] = [
    {
        "stamps": (dropped(100, "state: repeated time stamp"), "fail"),
        "effort sign": (lambda r: of_quantity(r, "effort", np.negative), "fail"),
        "frozen signal": (lambda r: changed(r, truth__elbow=stuck(300, 900)), "fail"),
    },
    {
        "stamps": (dropped(3, f"state: {BACK}"), "warn"),
        "effort": (lambda r: of_quantity(r, "effort", np.zeros_like), "fail"),
        "truth": (lambda r: without_truth(r, 0.7), "fail"),
    },
    {
        "homing": (lambda r: dropped(100, AMID)(r.rows(np.r_[:600, 700 : len(r)])), "fail"),
        "excitation": (lambda r: changed(r, measured__elbow=1.5 + 1e-6 * np.sin(r.t)), "warn"),
    },
]
"""By heading what makes a recording ill, and how bad it is; what one recording may have at once."""


def test_every_finding_has_a_heading():
    assert HEADING_OF.keys() == FINDINGS.keys()
    assert set(HEADING_OF.values()) == set(HEADINGS)


def test_a_healthy_recording_has_no_illness(healthy, other):
    diagnosis = diagnose(healthy, other)
    assert [v.heading for v in diagnosis.by_heading()] == list(HEADINGS[1:])  # but the live link's
    assert not diagnosis.failed
    for v in diagnosis.findings:
        assert v.what
        assert v.advice or v.level in ("good", "info")


@pytest.mark.parametrize("illnesses", ILLNESSES, ids=" and ".join)
def test_illnesses_are_told_by_their_names(healthy, illnesses):
    ill = healthy
    for make, _ in illnesses.values():
        ill = make(ill)
    told = by_heading(diagnose(ill))
    order = ("good", "info", "warn", "fail")
    for name, (_, level) in illnesses.items():
        assert order.index(told[name].level) >= order.index(level), told[name]
        assert told[name].advice


def standing(recording: Recording, joints: tuple[str, ...]) -> Recording:
    """Joints that creep and tremble where they stand."""
    n, random = len(recording), np.random.default_rng(0)
    drift = 1e-4 * np.linspace(0.0, 1.0, n)
    columns = {}
    for joint in joints:
        at = recording.column(f"measured/{joint}")[0]
        columns[f"measured__{joint}"] = at + drift + 1e-6 * random.normal(size=n)
        truth = np.round((at - drift) / 1e-4) * 1e-4  # which an encoder's counts hide
        columns[f"truth__{joint}"] = truth
    return changed(recording, **columns)


def test_of_an_arm_that_stands_nothing_is_judged_by_its_noise(healthy):
    told = by_heading(diagnose(standing(healthy, healthy.robot.positioning)))
    for name in ("arm", "effort sign", "frozen signal", "delay"):
        assert told[name].level == "info", told[name]
        assert "no joint moves" in told[name].text
    assert not [v for v in told.values() if v.level == "fail"]
    assert told["excitation"].text.startswith("shoulder, elbow, insertion stand")


def test_an_effort_is_not_judged_by_a_joint_that_goes_one_way(healthy):
    n = len(healthy)
    back = np.concatenate([np.linspace(0.5, 1.0, n // 2), np.linspace(1.0, 0.5, n - n // 2)])
    for way, level in ((np.linspace(0.5, 1.0, n), "good"), (back, "fail")):
        braking = -0.2 * np.sign(np.gradient(way))
        case = changed(healthy, measured__shoulder=way, effort__shoulder=braking)
        found = by_heading(diagnose(case))["effort sign"]
        assert found.level == level
        assert found.text.endswith("-100 % in shoulder") == (level == "fail")
        assert ("shoulder" in found.text) == (level == "fail")


def without(recording: Recording, *columns: str) -> Recording:
    """A recording without columns whose names begin so."""
    names = [str(name) for name in recording.table if not str(name).startswith(columns)]
    return Recording.from_columns(recording.table[names], recording.provenance)


def test_an_effort_that_is_not_there_is_not_called_good(healthy):
    found = by_heading(diagnose(without(healthy, "effort/elbow")))["effort sign"]
    assert (found.level, found.text) == ("info", "some of the coupled efforts are missing")


def test_a_joint_that_stands_spoils_no_verdict_of_those_that_move(healthy):
    told = {h: f.level for h, f in by_heading(diagnose(standing(healthy, ("elbow",)))).items()}
    assert told["frozen signal"] == told["arm"] == told["effort sign"] == "good"
    ill = standing(changed(healthy, truth__elbow=stuck(300, 900)), ("shoulder",))
    found = by_heading(diagnose(ill))["frozen signal"]
    assert "truth/elbow" in found.text
    # It says what the data check says.
    assert found.text in [f"{f.where}: {f.what}" for f in named(check_data(ill), "frozen")]


def test_the_other_arms_truth_is_told(healthy, other):
    rows = slice(min(len(healthy), len(other)))
    mine, theirs = healthy.rows(rows), other.rows(rows)
    foreign = {f"truth/{j}": theirs.column(f"truth/{j}") for j in theirs.joints_of("truth")}
    meanwhile = replace(changed(theirs, t=mine.t), provenance=mine.provenance)
    found = by_heading(diagnose(changed(mine, **foreign), meanwhile))["arm"]
    assert found.level == "fail"
    assert "swapped" in found.advice


def test_a_shift_is_estimated(healthy):
    found = by_heading(diagnose(late(healthy, 0.5)))["delay"]
    assert found.level == "fail"
    assert float(found.advice.rpartition(" ")[2]) == pytest.approx(-0.5, abs=0.03)


def test_without_truth_and_effort_it_still_judges(healthy):
    told = by_heading(diagnose(without(healthy, "truth", "effort")))
    assert (told["truth"].level, told["effort"].level) == ("info", "warn")
    assert told["effort sign"].text == "nothing to judge it by"
    assert told["effort sign"].level == "info"
    refused(
        "no measured position",
        diagnose,
        Recording.from_columns({"t": [0, 1], "effort/elbow": [0, 1]}, "raven2"),
    )
