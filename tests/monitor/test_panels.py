"""What the page says and draws of samples."""

from dataclasses import replace

import numpy as np
import pytest
from tests.crtk.faulty_backend import Fault, FaultyBackend

from truejoint.crtk.arm import Arm
from truejoint.monitor.panels import overview, plots, poses, status_html, table_html
from truejoint.monitor.samples import Condition, Samples
from truejoint.robots import get_robot
from truejoint.runtime import Status

ROBOT = get_robot("davinci_grasper")


@pytest.fixture
def samples(jaw_recording, jaw_model):
    return Samples.of_recording(jaw_recording, jaw_model).rows(slice(100, 300))


def _raven():
    """Two rows of a RAVEN-II at home, of which only three joints have sensors."""
    robot = get_robot("raven2")
    n = len(robot.joints)
    some = np.full((2, n), np.nan)
    some[:, :3] = robot.home[:3] + 0.1
    arrays = {"reported": np.tile(robot.home, (2, 1)), "truth": some}
    none = np.full((2, n), np.nan)
    rest = dict.fromkeys(("corrected", "half_width", "setpoint", "effort"), none)
    return robot, Samples(
        robot.joint_names, np.arange(2.0), **rest, **arrays,
        status=np.zeros(2, dtype=int), interval=np.full(2, np.nan), effort_units=("Nm",) * n,
    )  # fmt: skip


def test_a_pose_takes_reported_joints_where_no_sensor_is_and_needs_them_all():
    robot, samples = _raven()
    found = poses(samples, robot)
    assert list(found) == ["reported", "truth"]
    assert found["truth"][:3] == pytest.approx(robot.home[:3] + 0.1)
    assert found["truth"][3:] == pytest.approx(robot.home[3:])
    assert poses(replace(samples, joints=samples.joints[:3]), robot) == {}
    unknown = np.where(np.arange(len(robot.joints)) == 4, np.inf, samples.reported)
    assert poses(replace(samples, reported=unknown), robot) == {}


def test_plots_are_in_the_units_of_a_reader(samples):
    found = plots(samples, ROBOT, "jaw")
    assert list(found) == [
        "jaw [deg]", "correction of jaw [deg]", "corrected - true, jaw [deg]", "effort of jaw [Nm]",
        "between state messages [ms]",
    ]  # fmt: skip
    position, correction, error, _, messages = found.values()
    curves = {curve.label: curve.y for curve in position.curves}
    assert list(curves) == ["reported", "corrected", "true"]  # no set-point was recorded
    assert curves["reported"] == pytest.approx(np.degrees(samples.reported[:, 0]))
    assert not correction.curves[1].label  # a bound of the band
    upper, lower, correct, true = (curve.y for curve in correction.curves)
    width = np.degrees(samples.half_width[:, 0])
    assert upper - correct == pytest.approx(width)
    assert correct - lower == pytest.approx(width)
    assert true == pytest.approx(np.degrees(samples.truth - samples.reported)[:, 0])
    upper, lower, left = (curve.y for curve in error.curves)  # about the truth
    assert upper == pytest.approx(width)
    assert lower == pytest.approx(-width)
    assert left == pytest.approx(correct - true)
    assert messages.curves[0].y == pytest.approx(np.full(200, 10.0))


def test_every_calibrated_joint_has_its_correction_and_its_error():
    robot, samples = _raven()
    half = np.full((2, 7), np.nan)
    half[:, :2] = 0.01
    corrected = np.where(np.isfinite(half), samples.reported + 0.09, np.nan)
    several = replace(samples, corrected=corrected, half_width=half)
    assert several.calibrated == ("shoulder", "elbow")
    assert samples.calibrated == ("shoulder", "elbow", "insertion")  # those of known truth
    found = plots(several, robot)
    assert list(found) == [
        "correction of shoulder [deg]", "corrected - true, shoulder [deg]",
        "correction of elbow [deg]", "corrected - true, elbow [deg]",
    ]  # fmt: skip
    error = found["corrected - true, elbow [deg]"].curves[-1]
    assert error.y == pytest.approx(np.degrees([-0.01, -0.01]))
    assert "-0.57" in table_html(several, robot, is_fresh=True)


def test_an_overview_shows_the_largest_error_of_each_stretch(jaw_recording, jaw_model):
    samples = Samples.of_recording(jaw_recording, jaw_model)
    times = np.ceil(5000 / len(samples)).astype(int)
    long = Samples.joined([samples] * times)
    long = replace(long, t=np.arange(len(long)) / 100)
    long.truth[1234] += 0.5
    whole = overview(long, ROBOT, "jaw")
    curve = whole.curves[0]
    assert whole.y == "whole recording: corrected - true, jaw [deg]"
    assert len(curve.x) <= 600
    at = int(np.argmax(np.abs(curve.y)))
    assert curve.x[at] == pytest.approx(12.34)
    assert curve.y[at] == pytest.approx(np.degrees(-0.5), abs=1.0)
    none = replace(samples, corrected=np.full_like(samples.truth, np.nan))
    assert overview(none, ROBOT, "jaw").y == "whole recording: reported, jaw [deg]"


def test_a_plot_has_no_gap(samples):
    corrected = samples.corrected.copy()
    corrected[50:60] = np.nan
    plot = plots(replace(samples, corrected=corrected), ROBOT, "jaw")["jaw [deg]"]
    assert len(plot.curves[0].x) == 190
    assert all(np.isfinite(curve.y).all() for curve in plot.curves)


def test_what_is_lost_leaves_the_plot_and_the_rest_goes_on(samples):
    corrected = samples.corrected.copy()
    corrected[90:] = np.nan
    found = plots(replace(samples, corrected=corrected), ROBOT, "jaw")
    assert [curve.label for curve in found["jaw [deg]"].curves] == ["reported", "true"]
    assert len(found["jaw [deg]"].curves[0].x) == 200
    assert all(curve.label for curve in found["correction of jaw [deg]"].curves)


def test_without_a_model_and_truth_there_is_no_correction(samples):
    none = np.full_like(samples.truth, np.nan)
    bare = replace(samples, truth=none, corrected=none, half_width=none, effort=none)
    found = plots(bare, ROBOT, "jaw")
    assert list(found) == ["jaw [deg]", "between state messages [ms]"]
    table = table_html(bare, ROBOT, is_fresh=True)
    assert "corrected" not in table
    assert "effort" not in table


def test_the_table_holds_the_numbers(samples):
    table = table_html(samples, ROBOT, is_fresh=True)
    for name in ("reported", "corrected", "truth"):
        assert f"{np.degrees(getattr(samples, name)[-1, 0]):.2f}" in table
    assert f"&plusmn; {np.degrees(samples.half_width[-1, 0]):.2f}" in table
    assert "stale" not in table
    assert 'class="stale"' in table_html(samples, ROBOT, is_fresh=False)


def test_hostile_names_stay_text(samples):
    state = Condition("<script>", "<img src=x>", False, 5.0)
    text = status_html(state, replace(samples, effort_units=("<b>",)))
    assert "<script>" not in text
    assert "<img" not in text


def test_words_say_what_the_corrector_says(samples):
    flagged = replace(samples, status=np.full(200, int(Status.SPIKE | Status.STALE)))
    said = status_html(Condition("ENABLED"), flagged)
    assert "not corrected" in said
    assert Status.SPIKE.words in said
    assert Status.STALE.words in said
    assert "not corrected" not in status_html(Condition("ENABLED"), samples)
    assert "no state message yet" in status_html(Condition("ENABLED"), None)


def test_the_clock_tells_how_old_the_latest_message_is(samples):
    t = samples.t[-1]
    assert "no message" not in status_html(Condition("ENABLED", t=t + 0.01), samples)
    old = Condition("ENABLED", "silent", is_fresh=False, t=t + 7.25)
    assert "no message for 7 s" in status_html(old, samples)
    assert "no message for 3 min" in status_html(replace(old, t=t + 180.0), samples)


def test_an_arm_is_asked_how_it_stands(lagging_arm, lagging_backend):
    assert Condition.of(lagging_arm) == Condition("ENABLED", "", True, lagging_backend.time)
    lagging_backend.time += 3.0
    silent = Condition.of(lagging_arm)
    assert not silent.is_fresh
    assert silent.reason.startswith("the newest state message is 3 s old")
    lagging_arm.pause()
    assert Condition.of(lagging_arm).reason == "send 'resume' first"
    assert Condition.of(lagging_arm).state == "PAUSED"


def test_faults_and_silence_have_words(lagging_backend):
    arm = Arm(FaultyBackend(lagging_backend, [Fault("fault", 1.0)]))
    assert "send 'enable' first" in Condition.of(arm).reason
    arm.enable()
    assert "send 'home' first" in Condition.of(arm).reason
    arm.home()
    lagging_backend.time = 2.0
    failed = Condition.of(arm)
    assert failed.state == "FAULT"
    assert failed.reason.startswith("clear the fault on the robot")
    assert not failed.is_fresh
    arm._backend.operating_state = lambda: 1 / 0
    assert Condition.of(arm) == Condition("no answer", "division by zero", False, Condition("").t)
