"""A calibration as the prior of the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import truejoint
from truejoint.calibration import adapted, calibrate, find_zero, read_calibration, write_calibration
from truejoint.errors import CalibrationError
from truejoint.estimators.polynomial.learn import CHANGE_PENALTIES, changes
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot

FEATURES = ("measured/jaw", "effort/jaw")


def motion(seed, seconds=40.0, gain=1.02, zero=0.01, curve=0.0, noise=1e-4):
    """A jaw whose true position follows the measured one, its effort and a zero."""
    random = np.random.default_rng(seed)
    t = np.arange(round(50 * seconds)) / 50.0
    jaw = 0.5 + 0.3 * np.sin(0.7 * t + random.uniform(0, 6)) * np.sin(0.31 * t)
    effort = 0.02 * np.cos(1.1 * t + random.uniform(0, 6)) * np.sin(0.2 * t)
    truth = gain * jaw + 0.5 * effort + zero + curve * (jaw - 0.5) ** 2
    truth += noise * random.standard_normal(len(t))
    columns = {"t": t, "measured/jaw": jaw, "effort/jaw": effort, "truth/jaw": truth}
    about = Provenance("davinci_grasper", source=f"motion {seed}", homing_id=str(seed))
    return Recording.from_columns(columns, about)


def error(model, recording):
    left = recording.column("truth/jaw") - model.correct(recording)[:, 0]
    return float(np.sqrt(np.mean(left**2)))


def test_the_changes_are_a_ridge_regression_whose_penalty_is_cross_validated():
    random = np.random.default_rng(1)
    terms = random.normal([0.0, 2.0, 0.0], 1.0, (300, 3))
    left = terms @ [[0.5, 0.0], [-0.2, 0.0], [0.0, 0.0]] + [0.3, -0.1]
    left += random.standard_normal(left.shape) * [0.01, 1.0]
    slopes, offset, penalties = changes(terms, left)
    assert slopes.shape == (3, 2)
    assert penalties[0] <= 1e-3  # much to learn, little noise
    assert penalties[1] >= 1.0  # nothing but noise and a zero
    for j, penalty in enumerate(penalties):
        if np.isinf(penalty):
            expected, zero = np.zeros(3), left[:, j].mean()
        else:  # the penalty as rows of its own; the intercept has none
            wide = np.vstack([np.column_stack([terms, np.ones(300)]),
                              np.sqrt(300 * penalty) * np.eye(3, 4)])  # fmt: skip
            *expected, zero = np.linalg.lstsq(wide, np.append(left[:, j], np.zeros(3)))[0]
        np.testing.assert_allclose(slopes[:, j], expected, atol=1e-9)
        assert offset[j] == pytest.approx(zero)
    assert set(penalties) <= set(CHANGE_PENALTIES)
    with pytest.raises(CalibrationError, match="49 rows with truth"):
        changes(terms[:49], left[:49])


@pytest.mark.parametrize("estimator", ["linear", "poly2", "poly2_ridge", "rich_play"])
def test_a_few_seconds_of_another_day_are_enough(estimator, tmp_path):
    first = calibrate([motion(0, 120.0), motion(1, 120.0)], estimator, features=FEATURES)
    brief, test = motion(5, 6.0, 1.02, 0.04, noise=1e-3), motion(6, 60.0, 1.02, 0.04)
    model = adapted(first, brief)
    alone = first.at(find_zero(first, brief))
    assert error(first, test) > 0.02
    assert error(model, test) < 2e-3
    assert error(model, test) < 1.5 * error(alone, test)
    # A longer one changes more than the zero, and is kept in a file as any other.
    longer, other = motion(7, 60.0, 1.1, 0.04), motion(8, 60.0, 1.1, 0.04)
    again = adapted(first, longer)
    assert error(again, other) < 0.2 * error(first.at(find_zero(first, longer)), other)
    write_calibration(again, tmp_path / "m.safetensors")
    read = read_calibration(tmp_path / "m.safetensors")
    assert np.array_equal(read.correct(other), again.correct(other))
    assert read.metadata["prior"]["rows"] == first.metadata["rows"]
    assert read.estimator == estimator


def test_what_it_says_of_itself():
    first = calibrate([motion(0), motion(1)], "linear", features=FEATURES)
    first = first.with_metadata(choice={})
    model = adapted(first, motion(5, zero=0.5))
    assert model.metadata["rows"] == 2000
    assert model.origin.homing_ids == ("5",)
    sources = [session.source for session in model.origin.sessions]
    assert sources == ["motion 5", "motion 0", "motion 1"]
    assert "choice" not in model.metadata
    assert model.interval is None
    assert model.training_domain.error_upper[0] > 0.49 > first.training_domain.error_upper[0]
    assert set(model.baselines) == set(first.baselines)
    assert error(model.baselines["offset"], motion(6, zero=0.5)) < 0.02
    # From a prior that was re-zeroed, the same: the zero is found anew.
    moved = adapted(first.at(find_zero(first, motion(3, zero=0.2))), motion(5, zero=0.5))
    np.testing.assert_allclose(
        moved.correct(motion(6)), model.correct(motion(6)), atol=1e-4
    )  # of the penalty on what the zero moved


def test_a_reference_tells_the_zero_from_what_the_prior_never_followed():
    # A curve that the linear prior does not know, seen at one place alone.
    first = [motion(0, 60.0, curve=0.5), motion(1, 60.0, curve=0.5)]
    model = calibrate(first, "linear", features=FEATURES)
    whole, test = (motion(k, 60.0, curve=0.5, zero=0.04) for k in (5, 6))
    jaw, before = whole.column("measured/jaw"), error(model, motion(6, 60.0, curve=0.5))
    off: dict[int, list[float]] = {0: [], len(first): []}
    for place in (0.3, 0.5, 0.7):
        middle = int(np.argmin(np.abs(jaw[50:-50] - place))) + 50
        brief = whole.rows(slice(middle - 50, middle + 50))
        for reference in ((), first):
            now = adapted(model, brief, reference=reference)
            sources = [one.provenance.source for one in reference]
            assert now.metadata["prior"]["reference"] == sources
            assert now.metadata["prior"]["penalties"] == [None]
            assert set(now.baselines) == set(model.baselines)
            # The zero moved by 0.03, for the fixed offset too.
            off[len(reference)] += [now.offset[0] - 0.03, now.offsets["offset"][0] - 0.03]
        assert error(now, test) < 1.1 * before
    alone, beside = (np.sqrt(np.mean(np.square(values))) for values in off.values())
    assert beside < 2e-3
    assert alone > 3.0 * beside


def test_a_reference_is_of_the_prior_and_may_have_a_zero_of_its_own():
    first = [motion(0, 60.0, zero=0.0), motion(1, 60.0, zero=0.2)]
    model = calibrate(first, "linear", features=FEATURES, zero="recording")
    brief, test = motion(5, 6.0, zero=0.5), motion(6, 60.0, zero=0.5)
    assert error(adapted(model, brief, reference=first), test) < 1e-3
    seen = ["motion 5", "motion 0", "motion 1"]
    for reference, sources in ((first, seen), ([first[0], motion(2)], [*seen, "motion 2"])):
        sessions = adapted(model, brief, reference=reference).origin.sessions
        assert [session.source for session in sessions] == sources
    foreign = motion(3)
    foreign = replace(foreign, provenance=replace(foreign.provenance, robot="raven2"))
    with pytest.raises(CalibrationError, match="raven2"):
        adapted(model, brief, reference=[foreign])


def test_of_a_few_seconds_any_estimator_takes_the_zero():
    brief = truejoint.estimators.get_estimator("dnn").set_params(epochs=1)
    network = calibrate([motion(0), motion(1)], brief, features=FEATURES)
    short, test = motion(5, 20.0, zero=0.3), motion(6, 20.0, zero=0.3)
    left = short.column("truth/jaw") - network.correct(short)[:, 0]
    model = adapted(network, short)
    np.testing.assert_allclose(model.correct(test) - network.correct(test), left.mean())
    with pytest.raises(CalibrationError, match="dnn cannot be the prior"):
        adapted(network, motion(5, 60.0))


def test_what_cannot_be_a_prior_is_refused():
    pair = [motion(0), motion(1)]
    linear = calibrate(pair, "linear", features=FEATURES)
    for change, says in (
        ({"machine": get_robot("raven2", "left")}, "recordings are of davinci_grasper"),
        ({"moves": np.ones((2, 1))}, "re-zeroed by its motor"),
    ):
        with pytest.raises(CalibrationError, match=says):
            adapted(replace(linear, **change), motion(5))
    with pytest.raises(CalibrationError, match="lacks effort/jaw"):
        adapted(linear, Recording.from_columns(
            motion(5).table.drop(columns="effort/jaw"), "davinci_grasper"))  # fmt: skip
