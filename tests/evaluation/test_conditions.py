"""A test is told what it does that no recording of the training did."""

from functools import cache

import numpy as np
import pytest

import truejoint
from truejoint.recordings import Provenance, Recording, check_data


def swings(source="a.csv", *, rate=0.5, size=0.5, middle=0.2, force=1.0, slope=1.1, truth=True):
    t = np.arange(0.0, 30.0, 0.02)
    q = middle + size * np.sin(2.0 * np.pi * rate * t)
    columns = {"t": t, "measured/jaw": q, "effort/jaw": force * np.cos(2.0 * np.pi * rate * t)}
    known = np.where(np.arange(len(t)) % 2 == 0, slope * q + 0.01, np.nan)
    columns["truth/jaw"] = known if truth else np.full(len(t), np.nan)
    provenance = Provenance("davinci_grasper", source=source, session=source)
    return Recording.from_columns(columns, provenance, {"effort/jaw": "Nm"})


@pytest.fixture(scope="module")
def model():
    return truejoint.calibrate([swings("a"), swings("b", rate=0.6, slope=1.12)], "linear")


@cache
def checked():
    return check_data(swings())


def remarks(model, *tested):
    """Judge on data that were checked once: half of what it costs, and no matter of conditions."""
    return truejoint.evaluate(model, list(tested), check=checked()).verdict.remarks


BEYOND = [
    ({"rate": 0.3}, "jaw moves slower than in training in c0: 38."),
    ({"rate": 1.0}, "jaw moves faster than in training in c1: 12"),
    ({"size": 0.3, "rate": 0.9}, "jaw moves less far than in training in c2: 34.38 deg, learnt"),
    ({"size": 0.9, "rate": 0.3}, "jaw moves further than in training in c3: 103.1 deg, learnt"),
    ({"middle": -0.3}, "jaw moves about a lower position than in training in c4: -17.19 deg"),
    ({"middle": 0.6}, "jaw moves about a higher position than in training in c5: 34.38 deg"),
    ({"force": 0.5}, "jaw has smaller efforts than in training in c6: 0.3536 Nm, learnt 0.70"),
    ({"force": 2.0}, "jaw has larger efforts than in training in c7: 1.414 Nm, learnt 0.70"),
    ({"slope": 1.07}, "has a smaller slope of truth over measured than in training in c8: 1.07"),
    ({"slope": 1.15}, "jaw has a larger slope of truth over measured than in training in c9: 1."),
]


def test_each_condition_beyond_the_training_is_named_alone(model):
    found = remarks(model, *(swings(f"c{k}", **change) for k, (change, _) in enumerate(BEYOND)))
    assert len(found) == len(BEYOND)
    for _, text in BEYOND:
        assert any(text in remark for remark in found), text


def test_what_lies_between_is_not_named(model):
    assert remarks(model, swings("c", rate=0.55, slope=1.13, middle=0.3, force=1.2)) == ()


def test_where_no_recording_is_unlike_the_loop_names_the_rows_that_are(model):
    half, whole = swings("c", size=0.25, middle=0.05, rate=1.0), swings("c")
    t = whole.t
    columns = {n: np.r_[half.column(n)[: len(t) // 2], whole.column(n)[len(t) // 2 :]]
               for n in whole.units}  # fmt: skip
    both = Recording.from_columns({"t": t} | columns, whole.provenance, {"effort/jaw": "Nm"})
    (remark,) = remarks(model, both)
    assert remark.startswith("In ")
    assert remark.endswith(" % of the rows a joint swings between other points than in training.")


def test_recordings_are_named_together(model):
    (remark,) = remarks(model, swings("between"), *(swings(f"c{k}", force=3.0) for k in range(5)))
    assert remark.startswith("jaw has larger efforts than in training in c0, c1, c2 and 2 more: 2.")


def test_conditions_outlive_the_file_and_states_that_are_unknown(model, tmp_path):
    model.save(tmp_path / "m.safetensors")
    again = truejoint.read_calibration(tmp_path / "m.safetensors")
    conditions = [session.conditions for session in again.origin.sessions]
    assert conditions == [session.conditions for session in model.origin.sessions]
    assert conditions[1][0].slope == pytest.approx(1.12)
    silent = truejoint.calibrate(swings("a"), "linear")
    (condition,) = silent.origin.sessions[0].conditions
    assert condition.range == pytest.approx(1.0, abs=1e-3)
    assert condition.speed == pytest.approx(np.pi * 0.5 / np.sqrt(2.0), rel=0.02)
