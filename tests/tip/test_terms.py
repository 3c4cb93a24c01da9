"""Terms of the joints' corrections: taken from calibrations, and what those make one expect."""

from dataclasses import replace

import numpy as np
import pytest
from tests.tip.test_touch_calibration import session
from tests.tip.touched_arm import ROBOT, fitted

from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.tip.terms import AGAIN, WIDE, Terms, learned_priors, wide_priors

TERMS = Terms.of_workspace(ROBOT)


def test_a_calibration_of_these_terms_gives_its_own_coefficients(calibrated):
    model, report = calibrated
    found = TERMS.of_calibration(model, session(30, 5)[0])
    assert found == pytest.approx(report.fit.state.coefficients, abs=2e-3)


def test_a_linear_calibration_becomes_its_slopes():
    model, recording = fitted(), session(30, 5)[0]
    found = TERMS.of_calibration(model, recording)
    features = TERMS.features.compute(recording, model.gap_limit)
    basis = TERMS.basis(*TERMS.columns(features))
    expected = model.predict_error(recording)
    assert basis @ found == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


def test_no_zero_is_held_that_homing_moves(calibrated):
    model, recording = fitted(), session(30, 5)[0]
    priors = learned_priors(TERMS, model, recording)
    assert priors[0].mean == pytest.approx(TERMS.of_calibration(model, recording))
    assert priors[0].sd == pytest.approx([AGAIN[kind] for kind in TERMS.kinds])
    assert [(p.sd / priors[0].sd).mean() for p in priors] == pytest.approx([1.0, 2.0, 4.0])
    unsure = learned_priors(TERMS, calibrated[0], recording)[0]
    stated = np.array(calibrated[0].metadata["touch"]["zero_sd"]) / TERMS.scale
    assert unsure.sd[TERMS.zeros] == pytest.approx(np.hypot(AGAIN["zero"], stated))
    silent = calibrated[0].with_metadata(touch={"zero_sd": "small"})
    with pytest.raises(CalibrationError, match="does not say how surely it knows its zeros"):
        learned_priors(TERMS, silent, recording)


def test_without_calibrations_little_is_expected():
    first, *others = wide_priors(TERMS)
    assert not first.mean.any()
    assert first.sd == pytest.approx([WIDE[kind] for kind in TERMS.kinds])
    kinds = np.array(TERMS.kinds)
    for other in others:
        assert (other.sd[kinds == "zero"] == first.sd[kinds == "zero"]).all()
        assert (other.sd <= first.sd).all()
        assert (other.sd < first.sd).any()


def test_a_prior_of_another_arm_or_other_joints_is_refused():
    right = replace(fitted(), machine=get_robot("raven2", "right"))
    with pytest.raises(CalibrationError, match="give one that was made on recordings of this arm"):
        learned_priors(TERMS, right, session(30, 5)[0])
    with pytest.raises(CalibrationError, match="touches correct shoulder, elbow, insertion"):
        TERMS.of_calibration(replace(fitted(), joints=("elbow",)), session(30, 5)[0])
