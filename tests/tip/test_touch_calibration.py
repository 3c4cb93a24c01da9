"""Calibration from touches alone: what is seen comes out, what is not is said, the rest refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tests.tip.touched_arm import RATE, ROBOT, ROTATION, error_of, fitted, recorded

import truejoint
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording
from truejoint.runtime import Corrector
from truejoint.tip import Block, Touches, calibrate_by_touch
from truejoint.tip.terms import Terms
from truejoint.units import with_unit

TRUE_ZERO = np.array([0.01, 0.02, 1e-3])


def session(
    m: int = 30, seed: int = 0, *, noise: float = 1e-4, flat: bool = False, one_sided: bool = False
) -> tuple[Recording, Touches, Block, np.ndarray]:
    """Recording that goes from rest to rest, each in a dimple, its touches and the block."""
    rng = np.random.default_rng(seed)
    space = ROBOT.workspace
    rests = np.tile(ROBOT.home, (m, 1))
    rests[:, :3] = rng.uniform(space.lower, space.upper, (m, 3))
    sides = rng.choice([-1.0, 1.0], (m, 3))
    if one_sided:
        sides[:, 1] = 1.0
    rows = []
    for rest, side in zip(rests, sides, strict=True):
        away = rest.copy()
        away[:3] += 0.05 * space.extent * side
        share = np.linspace(0.0, 1.0, 15)[:, None]
        before = rows[-1][-1] if rows else away
        rows += [before + share * (away - before), away + share * (rest - away)]
        rows.append(np.tile(rest, (15, 1)))
    joint = np.concatenate(rows)
    true = rests.copy()
    true[:, :3] += error_of(rests) + TRUE_ZERO
    tip = ROBOT.kinematics.forward(true)[:, :3, 3]
    translation = tip.mean(axis=0)
    points = (tip - translation) @ ROTATION + noise * rng.standard_normal((m, 3))
    if flat:
        points[:, 2] = 0.0
    block = Block("block", "raven2", {str(k): p for k, p in enumerate(points)}, 0.08, 0.08)
    stamps = tuple(((45 * np.arange(m) + 44) / RATE).tolist())
    touches = Touches(stamps, tuple(str(k) for k in range(m)))
    return recorded(joint, TRUE_ZERO), touches, block, translation


def without_truth(recording: Recording) -> Recording:
    columns = {"t": recording.t}
    columns |= {c: recording.column(c) for c in recording.units if not c.startswith("truth")}
    return Recording.from_columns(columns, recording.provenance)


def error_in_block(model, translation: np.ndarray) -> float:
    """RMS error of the tip [m] on another motion, in a block that stands at `translation`."""
    recording, facts = session(20, 9)[0], model.metadata["touch"]
    joint = recording.columns("measured", ROBOT.joint_names)
    true = joint.copy()
    joint[:, :3], true[:, :3] = model.correct(recording), recording.columns("truth", model.joints)
    tip, there = (ROBOT.kinematics.forward(each)[:, :3, 3] for each in (joint, true))
    found = (tip - np.array(facts["translation"])) @ np.array(facts["rotation"]) / facts["scale"]
    return float(np.sqrt(((found - (there - translation) @ ROTATION) ** 2).sum(axis=1).mean()))


def test_what_was_not_seen_is_said_and_no_joint_accuracy_stated(calibrated):
    model, report = calibrated
    assert any(text.startswith("zero of shoulder: not seen") for text in report.not_seen)
    assert report.zero_sd[0] > np.deg2rad(2.0)
    assert report.zero_sd[2] < 3e-3
    assert model.metadata["truth"] == "touch"
    with pytest.raises(CalibrationError, match="states no interval"):
        model.required_interval()
    assert (model.effort_baseline.residual >= report.zero_sd).all()
    assert re.search(r"30 touches; tip [\d.]+ mm off near them, [\d.]+ mm over", str(model))
    assert "zero of shoulder: not seen" in str(model)


def test_it_is_an_ordinary_model(calibrated, tmp_path):
    model, report = calibrated
    recording = without_truth(session(15, 3)[0])
    terms = Terms.of_workspace(ROBOT)
    features = terms.features.compute(recording, model.gap_limit)
    expected = terms.basis(*terms.columns(features)) @ report.fit.state.coefficients
    assert model.predict_error(recording) == pytest.approx(expected, abs=1e-12)
    path = tmp_path / "touched.safetensors"
    truejoint.write_calibration(model, path)
    corrector = Corrector(path)
    corrector.set_homing(True, "1")
    trace = corrector.run(recording)
    assert trace.position == pytest.approx(model.correct(recording), abs=1e-12)


def test_wrong_touches_are_named_and_do_little_harm():
    recording, touches, block, translation = session(30, 2)
    points = dict(block.points)
    points["4"] = points["4"] + [1.5e-3, 1e-3, -1e-3]
    points["11"], points["20"] = points["20"], points["11"]
    model, report = calibrate_by_touch(recording, touches, replace(block, points=points))
    assert model.metadata["touch"]["left_out"] == ["4", "11", "20"]
    assert error_in_block(model, translation) < 4e-4
    assert report.tip.rms < 5e-4


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"m": 8}, "8 different dimples; to calibrate it takes 12 or more"),
        ({"flat": True}, "in one plane"),
        ({"one_sided": True}, "elbow comes from one side"),
    ],
)
def test_touches_that_hide_something_are_refused(how, said):
    recording, touches, block, _ = session(**how)
    with pytest.raises(CalibrationError, match=said):
        calibrate_by_touch(recording, touches, block)


def test_a_block_of_another_robot_is_refused():
    recording, touches, block, _ = session()
    with pytest.raises(CalibrationError, match="is for dvrk_psm, not raven2"):
        calibrate_by_touch(recording, touches, replace(block, robot="dvrk_psm"))


def test_an_older_model_of_the_arm_holds_what_touches_do_not_see():
    recording, touches, block, _ = session(12, 4, noise=2e-4)
    helped, report = calibrate_by_touch(recording, touches, block, prior=fitted())
    assert helped.metadata["touch"]["prior"] == ["raven2 (left arm)"]
    assert report.zero_sd[0] < np.deg2rad(1.01)
    assert report.not_seen[0].startswith("zero of shoulder: not seen, assumed within")
    # A prior that is exactly right does not hide its error.
    assert (np.linalg.norm(report.left_out, axis=1) > 1e-6).all()
    assert np.sqrt((report.left_out**2).sum(axis=1).mean()) > 2e-4


def test_a_prior_that_contradicts_the_touches_is_not_used(calibrated):
    recording, touches, block, translation = session()
    wrong = replace(fitted(), offsets={"model": np.array([0.0, 0.5, 0.05])})
    model, report = calibrate_by_touch(recording, touches, block, prior=wrong)
    assert report.not_seen[-1].startswith("the prior: the touches are likelier without it")
    assert model.metadata["touch"]["prior"] == []
    error, expected = (error_in_block(each, translation) for each in (model, calibrated[0]))
    assert error == pytest.approx(expected, rel=1e-6)
    assert 0.5 * error < report.tip.rms < 2.0 * error < 6e-4


def test_the_size_of_a_print_is_found_by_a_prior_and_named_without(calibrated):
    recording, touches, block, _ = session(30, 2)
    small = replace(block, points={n: p / 0.99 for n, p in block.points.items()}, measured=np.nan)
    _, blind = calibrate_by_touch(recording, touches, small)
    assert any(text.startswith("size of the print: not seen") for text in blind.not_seen)
    model, report = calibrate_by_touch(recording, touches, small, prior=fitted())
    (told,) = (text for text in report.not_seen if text.startswith("size of the print: -"))
    assert "measure it, and enter measured_mm" in told
    assert model.metadata["touch"]["scale"] == pytest.approx(0.99, abs=4 * report.fit.sd[-4])
    measured, calm = calibrated
    (taken,) = (text for text in calm.not_seen if text.startswith("size of the print"))
    assert taken.startswith("size of the print: not seen, taken as stated; 1 % of it is 0.")
    assert measured.metadata["touch"]["scale"] == pytest.approx(1.0, abs=2e-3)


def test_the_raw_error_is_stated_and_never_nothing(calibrated):
    model, report = calibrated
    squares = (report.left_out**2).sum(axis=1)
    assert report.left_out_rms == pytest.approx(np.sqrt(squares.mean()))
    assert report.tip.sd > 0.0
    assert report.tip.rms > np.sqrt((report.fit.residual**2).sum(axis=1).mean() / 30)
    assert model.metadata["touch"]["tip_error"] == report.tip.rms
    assert report.workspace.rms > report.tip.rms
    assert not report.is_measured
    raw, most, where = report.statement
    assert f"left out in turn are {with_unit(report.left_out_rms, 'm')} off" in raw
    assert f"at most {with_unit(report.left_out_rms, 'm')} off" in most
    assert "of which the noise that you stated may be 0.346 mm" in most
    assert f"{report.reach:.0%} of which lies amid the touches" in where
    # Before: as measured, with the block laid over the tip.
    assert np.abs(report.before.mean(axis=0)).max() < 1e-9
    assert np.linalg.norm(report.before) > 2 * np.linalg.norm(report.left_out)
