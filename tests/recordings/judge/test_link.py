"""The doctor tells each illness by its name, from a recording made ill in exactly that way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.recordings.judge.faults import by_heading, changed, stuck, unset

from truejoint.crtk import simulated_arm
from truejoint.errors import RecordingError
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


def scaled(recording: Recording, quantity: str, factor: float) -> Recording:
    names = [f"{quantity}/{joint}" for joint in recording.joints_of(quantity)]
    return replace(
        recording, table=recording.table.assign(**{n: factor * recording.table[n] for n in names})
    )


def dropped(count: int, reason: str) -> Callable[[Recording], Recording]:
    return lambda r: replace(r, provenance=replace(r.provenance, dropped={reason: count}))


def late(recording: Recording, seconds: float) -> Recording:
    shifted = {
        f"truth/{j}": np.interp(recording.t - seconds, recording.t, recording.column(f"truth/{j}"))
        for j in recording.joints_of("truth")
    }
    return replace(recording, table=recording.table.assign(**shifted))


def gone(recording: Recording, first: int, last: int) -> Recording:
    rows = np.arange(len(recording))
    return recording.rows(rows[(rows < first) | (rows >= last)])


def without_truth(recording: Recording, share: float) -> Recording:
    rows = np.arange(len(recording)) < share * len(recording)
    names = {
        f"truth/{j}": np.where(rows, np.nan, recording.column(f"truth/{j}"))
        for j in recording.joints_of("truth")
    }
    return replace(recording, table=recording.table.assign(**names))


ILLNESSES: dict[str, tuple[Callable[[Recording], Recording], str, str]] = {
    "stamps that repeat": (dropped(100, "state: repeated time stamp"), "stamps", "fail"),
    "stamps that go back": (dropped(3, f"state: {BACK}"), "stamps", "warn"),
    "effort turned round": (lambda r: scaled(r, "effort", -1.0), "effort sign", "fail"),
    "effort never set": (unset, "effort", "fail"),
    "frozen": (lambda r: stuck(r, 300, 900), "frozen signal", "fail"),
    "no overlap": (lambda r: without_truth(r, 0.7), "truth", "fail"),
    "late by half a second": (lambda r: late(r, 0.5), "delay", "fail"),
    "homing inside": (lambda r: dropped(100, AMID)(gone(r, 600, 700)), "homing", "fail"),
    "standing still": (
        lambda r: changed(r, measured__elbow=np.full(len(r), 1.5) + 1e-6 * np.sin(r.t)),
        "excitation",
        "warn",
    ),
}


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


@pytest.mark.parametrize("illness", ILLNESSES)
def test_an_illness_is_told_by_its_name(healthy, illness):
    make, name, level = ILLNESSES[illness]
    told = by_heading(diagnose(make(healthy)))
    order = ("good", "info", "warn", "fail")
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
    one_way = changed(
        healthy, measured__shoulder=np.linspace(0.5, 1.0, n), effort__shoulder=np.full(n, -0.2)
    )
    told = by_heading(diagnose(one_way))["effort sign"]
    assert told.level == "good"
    assert "shoulder" not in told.text
    back = np.concatenate([np.linspace(0.5, 1.0, n // 2), np.linspace(1.0, 0.5, n - n // 2)])
    turned = changed(
        healthy, measured__shoulder=back, effort__shoulder=-0.2 * np.sign(np.gradient(back))
    )
    told = by_heading(diagnose(turned))["effort sign"]
    assert told.level == "fail"
    assert told.text.endswith("-100 % in shoulder")


def test_an_effort_that_is_not_there_is_not_called_good(healthy):
    names = [c for c in healthy.table if str(c) != "effort/elbow"]
    bare = Recording.from_columns(healthy.table[names], healthy.provenance)
    told = by_heading(diagnose(bare))["effort sign"]
    assert (told.level, told.text) == ("info", "some of the coupled efforts are missing")
    none = [name for name in names if not str(name).startswith("effort/")]
    bare = Recording.from_columns(healthy.table[none], healthy.provenance)
    told = by_heading(diagnose(bare))["effort sign"]
    assert (told.level, told.text) == ("info", "nothing to judge it by")


def test_a_joint_that_stands_spoils_no_verdict_of_those_that_move(healthy):
    told = {h: f.level for h, f in by_heading(diagnose(standing(healthy, ("elbow",)))).items()}
    assert told["frozen signal"] == told["arm"] == told["effort sign"] == "good"
    ill = by_heading(diagnose(standing(stuck(healthy, 300, 900), ("shoulder",))))
    assert "truth/elbow" in ill["frozen signal"].text


def test_the_other_arms_truth_is_told(healthy, other):
    rows = min(len(healthy), len(other))
    foreign = {f"truth/{j}": other.column(f"truth/{j}")[:rows] for j in other.joints_of("truth")}
    mine = healthy.rows(slice(0, rows))
    mixed = replace(mine, table=mine.table.assign(**foreign))
    meanwhile = replace(other.rows(slice(0, rows)), provenance=mine.provenance)
    meanwhile = replace(meanwhile, table=meanwhile.table.assign(t=mine.t))
    told = by_heading(diagnose(mixed, meanwhile))["arm"]
    assert told.level == "fail"
    assert "swapped" in told.advice


def test_a_shift_is_estimated(healthy):
    told = by_heading(diagnose(late(healthy, 0.5)))["delay"]
    assert float(told.advice.rpartition(" ")[2]) == pytest.approx(-0.5, abs=0.03)


def test_it_says_what_the_data_check_says(healthy):
    ill = stuck(healthy, 300, 900)
    check = check_data(ill)
    told = by_heading(diagnose(ill))["frozen signal"]
    assert any(told.text == f"{f.where}: {f.what}" for f in check.findings if f.name == "frozen")


def test_without_truth_and_effort_it_still_judges(healthy):
    names = [c for c in healthy.table if not str(c).startswith(("truth", "effort"))]
    bare = Recording.from_columns(healthy.table[names], healthy.provenance)
    told = {h: f.level for h, f in by_heading(diagnose(bare)).items()}
    assert told["truth"] == "info"
    assert told["effort"] == "warn"
    with pytest.raises(RecordingError, match="no measured position"):
        diagnose(Recording.from_columns({"t": [0, 1], "effort/elbow": [0, 1]}, "raven2"))
