"""The error stated of a tip against the true one, on drawn arms; at length in benchmarks."""

import numpy as np
import pytest
from tests.drawn_arm import NOISE, DrawnArm, block_session, tracker_session

from truejoint.tip import calibrate_by_touch

MAKE = {"block": block_session, "tracker": tracker_session}


@pytest.mark.parametrize(("kind", "repeats"), [("block", 6), ("block", 0), ("tracker", 6)])
def test_the_stated_error_is_near_the_true_one_whatever_noise_is_stated(kind, repeats):
    ratios = []
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
    assert 0.75 < np.median(ratios) < 1.33
    assert (np.abs(np.log(ratios)) < np.log(1.8)).all()
