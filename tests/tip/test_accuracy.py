"""The error stated of a tip against the true one, on drawn arms; at length in benchmarks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.drawn_arm import NOISE, DrawnArm, block_session, tracker_session

from truejoint.tip import calibrate_by_touch
from truejoint.tip.accuracy import heavy_tailed
from truejoint.tip.fit import TipPrior, TipState

MAKE = {"block": block_session, "tracker": tracker_session}


@pytest.mark.parametrize(("kind", "repeats"), [("block", 6), ("block", 0), ("tracker", 6)])
def test_the_stated_error_is_near_the_true_one_whatever_noise_is_stated(kind, repeats):
    ratios, off = [], []
    for seed, factor in ((0, 1.0), (1, 0.5), (2, 2.0)):
        session = MAKE[kind](DrawnArm(seed), 30, repeats)
        model, report = calibrate_by_touch(
            session.recording, session.touches, session.block, touch_sd=factor * NOISE[kind]
        )
        assert report.is_measured == (repeats > 0)
        assert report.fit.rows.point_sd == pytest.approx(NOISE[kind], rel=0.4)
        said = [text for text in report.not_seen if text.startswith("noise: the residuals say")]
        assert bool(said) == (factor != 1.0)
        unseen = any(text.startswith("the marker: whether it sits") for text in report.not_seen)
        assert unseen == (kind == "tracker")  # which no wrist turns
        ratios.append(report.tip.rms / session.tip_error(model, near=True))
        off.append((1.0 - 1.0 / ratios[-1]) * report.tip.rms / report.tip.sd)
    assert 0.75 < np.median(ratios) < 1.33
    assert (np.abs(np.log(ratios)) < np.log(1.8)).all()
    # The deviation holds what chance makes of one arm, and no more.
    assert np.sqrt(np.mean(np.square(off))) < 2.5
    assert report.tip.sd < 0.4 * report.tip.rms


def test_a_term_far_larger_than_most_is_not_drawn_to_nothing():
    state = TipState(np.array([10.0, 10.0, 0.0]))
    prior = TipPrior.of(replace(state, coefficients=np.zeros(3)), np.ones(3))
    fit = SimpleNamespace(state=state, sd=np.zeros(len(prior.free)))
    weight = np.diag(heavy_tailed(fit, prior, ("zero", "slope", "square")).precision)[:3]
    assert weight == pytest.approx([1.0, 2.0 / 101.0, 2.0])
