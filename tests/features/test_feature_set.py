"""Features are causal, exact, and the same offline as in the loop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from truejoint.errors import CalibrationError, RecordingError
from truejoint.features import Feature, FeatureSet, default_features
from truejoint.features.feature_set import feature_row
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot

EVERY_OPERATION = (
    "measured/jaw",
    "lag(measured/jaw, 3)",
    "lowpass(measured/jaw, 0.05)",
    "rate(measured/jaw, 0.02)",
    "play(measured/jaw, 0.0175)",
    "effort/jaw",
    "lowpass(effort/jaw, 0.2)",
)


def jaw_recording(t: np.ndarray, x: np.ndarray) -> Recording:
    columns = {"t": t, "measured/jaw": x, "effort/jaw": np.cos(3 * x)}
    return Recording.from_columns(columns, Provenance("davinci_grasper", source="made.csv"))


def values_of(text: str, t: np.ndarray, x: np.ndarray) -> np.ndarray:
    return FeatureSet.parse([text]).compute(jaw_recording(t, x), 1e6)[:, 0]


def every_value(t: np.ndarray, x: np.ndarray, gap_limit: float = 1e6) -> np.ndarray:
    return FeatureSet.parse(EVERY_OPERATION).compute(jaw_recording(t, x), gap_limit)


@given(st.floats(1e-9, 3600.0), st.integers(1, 10_000))
def test_any_parameter_reads_back(constant, samples):
    for feature in (
        Feature("measured/jaw"),
        Feature("measured/jaw", "rate", constant),
        Feature("measured/jaw", "lowpass", constant),
        Feature("measured/jaw", "play", constant),
        Feature("measured/jaw", "lag", samples),
    ):
        assert Feature.parse(str(feature)) == feature


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("jaw", "<quantity>/<channel>"),
        ("measured/../jaw", "<quantity>/<channel>"),
        ("truth/jaw", "has to find"),
        ("lag(measured/jaw, 0)", "1 to 10000 samples"),
        ("lag(measured/jaw, 2.5)", "1 to 10000 samples"),
        ("lowpass(measured/jaw, -1)", "lowpass takes up to 3600 s"),
        ("rate(measured/jaw, nan)", "rate takes up to 3600 s"),
        ("play(measured/jaw, inf)", "half-width above 0"),
        ("play(measured/jaw, wide)", "'wide' is not a number"),
        ("sinc(measured/jaw, 1)", "no feature operation 'sinc'"),
        ("value(measured/jaw, 0)", "write 'measured/jaw'"),
        ("", "<quantity>/<channel>"),
    ],
)
def test_wrong_text_is_refused_in_one_line(text, said):
    with pytest.raises(CalibrationError, match=said) as caught:
        Feature.parse(text)
    assert "\n" not in str(caught.value)


@given(st.text(max_size=60))
def test_arbitrary_text_is_a_feature_or_an_error(text):
    try:
        feature = Feature.parse(text)
    except CalibrationError:
        return
    assert Feature.parse(str(feature)) == feature


@pytest.mark.parametrize(
    "texts", [[], ["measured/jaw", "measured/jaw"], ["a/b"] * 600, 3, [3], [None]]
)
def test_sets_that_are_empty_repeated_or_huge_are_refused(texts):
    with pytest.raises(CalibrationError):
        FeatureSet.parse(texts)


def test_lag_is_the_value_some_rows_ago():
    t, x = np.arange(8.0), np.arange(8.0) ** 2
    np.testing.assert_array_equal(
        values_of("lag(measured/jaw, 3)", t, x), [0, 0, 0, 0, 1, 4, 9, 16]
    )


def test_play_stands_still_within_its_band():
    x = np.array([0.0, 0.5, 1.0, 3.0, 2.0, 1.0, 0.0, -2.0, -1.0, 0.5])
    expected = [0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 1.0, -1.0, -1.0, -0.5]
    np.testing.assert_allclose(values_of("play(measured/jaw, 1.0)", np.arange(10.0), x), expected)


def test_lowpass_of_a_ramp_is_exact_at_uneven_spacing():
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.001, 0.3, 200))
    slope, constant = 0.7, 0.05
    s = t - t[0]
    exact = 2.0 + slope * (s - constant * (1 - np.exp(-s / constant)))
    np.testing.assert_allclose(values_of("lowpass(measured/jaw, 0.05)", t, 2 + slope * s), exact)
    np.testing.assert_allclose(
        values_of("rate(measured/jaw, 0.05)", t, 2 + slope * s),
        slope * (1 - np.exp(-s / constant)),
        atol=1e-12,
    )


def samples(n: int = 40) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(float, n, elements=st.floats(-1e3, 1e3))


@given(samples(), hnp.arrays(float, 40, elements=st.floats(1e-3, 5.0)), st.floats(1e-3, 6.0))
def test_online_equals_offline_bit_for_bit_so_no_feature_sees_the_future(x, steps, gap_limit):
    recording = jaw_recording(np.cumsum(steps), x)
    feature_set = FeatureSet.parse(EVERY_OPERATION)
    offline = feature_set.compute(recording, gap_limit)
    memory, clock = np.zeros(feature_set.memory_size), np.zeros(2)
    out = np.empty(len(feature_set))
    signals = np.column_stack([recording.column(s) for s in feature_set.signals])
    starts = np.diff(recording.t, prepend=-np.inf) > gap_limit
    for row, t in enumerate(recording.t):
        fresh = feature_row(*feature_set.program, gap_limit, t, signals[row], memory, clock, out)
        assert fresh == starts[row]
        assert out.tobytes() == offline[row].tobytes()


@given(samples(), st.integers(2, 37))
def test_history_starts_anew_after_a_gap(x, row):
    t = np.arange(40) * 0.03
    t[row:] += 1.0
    assert every_value(t, x, 0.3)[row:].tobytes() == every_value(t[row:], x[row:]).tobytes()


def test_default_gap_is_ten_time_steps(recording):
    t = recording.t.copy()
    t[700:] += 2.0
    table = recording.table.assign(t=t)
    gapped = Recording(table, recording.units, recording.provenance)
    text = "lowpass(measured/elbow, 1.0)"
    first = FeatureSet.parse([text]).compute(gapped)[700, 0]
    assert first == gapped.column("measured/elbow")[700]


def test_defaults_are_the_sixteen_of_the_paper(recording):
    names = default_features(recording.robot, recording).names
    assert len(names) == 16
    assert names[:4] == ("measured/shoulder", "measured/elbow", "measured/insertion",
                         "measured/unused")  # fmt: skip
    assert names[8:] == tuple(f"effort/{c}" for c in recording.robot.channels)


def test_defaults_need_a_signal():
    t = np.arange(5.0)
    bare = Recording.from_columns({"t": t, "truth/jaw": t}, Provenance("davinci_grasper"))
    with pytest.raises(CalibrationError, match="no measured or effort column"):
        default_features(get_robot("davinci_grasper"), bare)


def test_missing_signal_is_named():
    with pytest.raises(RecordingError, match="current/jaw"):
        FeatureSet.parse(["current/jaw"]).compute(jaw_recording(np.arange(5.0), np.arange(5.0)))
