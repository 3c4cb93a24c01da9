"""Terms of the joints' corrections: taken from calibrations, and what those make one expect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.tip.test_touch_calibration import session, without_truth
from tests.tip.touched_arm import ROBOT, fitted

from truejoint import Calibration
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.tip import calibrate_by_touch
from truejoint.tip.terms import AGAIN, ALIKE, WIDE, Terms, check_priors, learned_priors, wide_priors

TERMS = Terms.of_workspace(ROBOT)


@pytest.fixture(scope="module")
def touched_model() -> tuple[Calibration, np.ndarray]:
    recording, touches, block, _ = session()
    model, report = calibrate_by_touch(without_truth(recording), touches, block)
    return model, report.fit.state.coefficients


def test_a_calibration_of_these_terms_gives_its_own_coefficients(touched_model):
    model, coefficients = touched_model
    found = TERMS.of_calibration(model, session(30, 5)[0])
    assert found == pytest.approx(coefficients, abs=2e-3)


def test_a_linear_calibration_becomes_its_slopes():
    model, recording = fitted(), session(30, 5)[0]
    found = TERMS.of_calibration(model, recording)
    features = TERMS.features.compute(recording, model.gap_limit)
    basis = TERMS.basis(*TERMS.columns(features))
    expected = model.predict_error(recording)
    assert basis @ found == pytest.approx(expected, abs=0.02 * np.abs(expected).max())
    # One arm's calibration is taken for another's.
    other = replace(model, machine=get_robot("raven2", "right"))
    assert TERMS.of_calibration(other, recording) == pytest.approx(found, abs=1e-12)


def test_of_several_arms_the_mean_and_its_spread_are_expected():
    model, recording = fitted(), session(30, 5)[0]
    shifts = np.array([[0.0, 0.0, 0.0], [0.08, -0.1, 2e-3], [-0.05, 0.09, 4e-3]])
    known = [replace(model, offsets={**model.offsets, "model": shift}) for shift in shifts]
    rows = np.array([TERMS.of_calibration(one, recording) for one in known])
    priors = learned_priors(TERMS, known, recording)
    assert priors[0].mean == pytest.approx(rows.mean(axis=0))
    zeros = rows[:, TERMS.zeros]
    # Of one more arm against the mean of three.
    expected = np.sqrt(4 / 3 * zeros.var(axis=0, ddof=1).mean())
    assert expected > AGAIN["zero"]
    assert priors[0].sd[TERMS.zeros] == pytest.approx(expected)
    assert [(p.sd / priors[0].sd).mean() for p in priors] == pytest.approx([1.0, 2.0, 4.0])


def test_arms_that_agree_do_not_hold_a_zero_that_homing_moves(touched_model):
    model, recording = fitted(), session(30, 5)[0]
    alike = learned_priors(TERMS, [model] * 3, recording)[0]
    assert alike.sd[TERMS.zeros] == pytest.approx(AGAIN["zero"])
    kinds = np.array(TERMS.kinds)
    for kind in ("slope", "square", "play"):
        assert alike.sd[kinds == kind] == pytest.approx(ALIKE * AGAIN[kind])
    unsure = learned_priors(TERMS, [touched_model[0]] * 3, recording)[0]
    stated = np.array(touched_model[0].metadata["touch"]["zero_sd"]) / TERMS.scale
    assert unsure.sd[TERMS.zeros] == pytest.approx(np.hypot(AGAIN["zero"], stated))
    silent = touched_model[0].with_metadata(touch={"zero_sd": "small"})
    with pytest.raises(CalibrationError, match="does not say how surely it knows its zeros"):
        learned_priors(TERMS, [silent] * 3, recording)


@pytest.mark.parametrize("copies", [3, 4])  # whose mean is theirs to a bit, and exactly
def test_copies_of_one_calibration_neither_break_the_fit_nor_hide_its_error(copies):
    recording, touches, block, _ = session(30, 2, noise=2e-4)
    model, report = calibrate_by_touch(recording, touches, block, priors=[fitted()] * copies)
    assert len(model.metadata["touch"]["prior"]) == copies
    assert (np.linalg.norm(report.left_out, axis=1) > 1e-6).all()
    assert np.sqrt((report.left_out**2).sum(axis=1).mean()) > 2e-4


def test_without_calibrations_little_is_expected():
    first, *others = wide_priors(TERMS)
    assert not first.mean.any()
    assert first.sd == pytest.approx([WIDE[kind] for kind in TERMS.kinds])
    kinds = np.array(TERMS.kinds)
    for other in others:
        assert (other.sd[kinds == "zero"] == first.sd[kinds == "zero"]).all()
        assert (other.sd <= first.sd).all()
        assert (other.sd < first.sd).any()


@pytest.mark.parametrize(
    ("count", "machine", "said"),
    [
        (1, get_robot("forceps"), "give one of the same robot"),
        (1, get_robot("raven2", "right"), "or a folder of 3 or more"),
        (2, ROBOT, "2 calibrations are too few"),
    ],
)
def test_a_prior_that_says_nothing_of_this_arm_is_refused(count, machine, said):
    known = [replace(fitted(), machine=machine)] * count
    with pytest.raises(CalibrationError, match=said):
        check_priors(known, ROBOT)
    with pytest.raises(CalibrationError, match="touches correct shoulder, elbow, insertion"):
        TERMS.of_calibration(replace(fitted(), joints=("elbow",)), session(30, 5)[0])
