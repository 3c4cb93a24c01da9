"""A family: its rules, its shapes, its memory and its row, whatever it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.refusals import refused
from tests.runtime.streams import ready, stream, trained

from truejoint.calibration import Calibration
from truejoint.calibration.model_file import encode, to_bytes
from truejoint.compiled import compiled
from truejoint.errors import ModelFileError
from truejoint.estimators import family as families
from truejoint.estimators import rules
from truejoint.estimators.family import EstimatorData, Family
from truejoint.layout import Layout
from truejoint.runtime import Corrector, Status

LAYOUT = Layout()
SECONDS = LAYOUT.add("seconds", "scalar", "since the history started [s]")


@compiled
def clock_row(numbers, memory, dt, x, out, half_width):
    """Time since the history started."""
    memory[SECONDS] = 0.0 if dt == 0.0 else memory[SECONDS] + dt
    for j in range(out.shape[0]):
        out[j] = 1e-3 * memory[SECONDS] + 1e-6 * x[0]


@compiled
def helpless_row(numbers, memory, dt, x, out, half_width):
    """Knows that it knows nothing."""
    for j in range(out.shape[0]):
        out[j] = np.nan


CLOCK = Family(
    "clock",
    rules={
        "rate": rules.number(0.5, 2.0),
        "count": rules.integer(1, 9),
        "kind": rules.one_of("slow", "fast", True),
        "widths": rules.numbers(3, 0.0, 1.0, "lengths [m]"),
        "seed": rules.RANDOM_STATE,
    },
    shapes=lambda params, k, n: {"gain": (params["count"], k), "offset": (n,)},
    pack=lambda _params, _arrays, _k, _n: LAYOUT.pack(),
    row=clock_row,
    remembers=True,
    inputs=lambda params: ("measured/elbow", "effort/elbow")[: params["count"]],
)
GOOD = {"rate": 1.0, "count": 2, "kind": "slow", "widths": (0.1, 0.2), "seed": None}


@given(st.one_of(st.floats(), st.integers(), st.booleans(), st.text(max_size=3), st.none()))
def test_a_number_is_finite_real_and_within_its_bounds(value):
    real = isinstance(value, (int, float)) and not isinstance(value, bool)
    assert rules.is_number(value, -2.5, 7.0) == (real and -2.5 <= value <= 7.0)
    whole = real and isinstance(value, int)
    assert rules.is_integer(value, -2, 7) == (whole and -2 <= value <= 7)


def test_numbers_of_numpy_are_numbers():
    assert rules.is_number(np.float32(1.0), 0.0, 2.0)
    assert rules.is_integer(np.int64(1), 0, 2)
    assert not rules.is_integer(np.float64(1.0), 0, 2)
    assert not rules.is_number(np.bool_(True), 0.0, 2.0)


@pytest.mark.parametrize(
    ("name", "value", "rule"),
    [
        ("rate", 0.4, "a number from 0.5 to 2"),
        ("rate", float("nan"), "a number from 0.5 to 2"),
        ("rate", True, "a number from 0.5 to 2"),
        ("count", 2.0, "an integer from 1 to 9"),
        ("count", 10, "an integer from 1 to 9"),
        ("kind", "quick", "one of slow, fast, True"),
        ("kind", 1, "one of slow, fast, True"),
        ("widths", (), r"1 to 3 lengths \[m\] from 0 to 1"),
        ("widths", (0.1,) * 4, r"1 to 3 lengths \[m\] from 0 to 1"),
        ("widths", [0.1, 1.1], r"1 to 3 lengths \[m\] from 0 to 1"),
        ("widths", 0.1, r"1 to 3 lengths \[m\] from 0 to 1"),
        ("seed", -1, r"None or an integer from 0 to 2\*\*32 - 1"),
    ],
)
def test_a_parameter_names_itself_and_its_rule(name, value, rule):
    CLOCK.check_params(GOOD)
    refused(f"^clock parameter {name} is .*; it must be {rule}$", CLOCK.check_params,
            {**GOOD, name: value})  # fmt: skip


def test_a_long_value_is_cut():
    refused("^.{1,160}$", CLOCK.check_params, {**GOOD, "kind": "x" * 10_000})


def test_parameters_and_features_are_as_many_as_it_has():
    refused("clock has parameters .*; it needs .*'rate'", CLOCK.check_params, {})
    refused("it needs", CLOCK.check_params, {**GOOD, "more": 1})
    CLOCK.check_size(GOOD, 2)
    refused("takes 2 features, in the order of measured/elbow, effort/elbow; 3 are given",
            CLOCK.check_size, GOOD, 3)  # fmt: skip
    replace(CLOCK, inputs=None).check_size(GOOD, 3)


GAIN, OFFSET = {"gain": np.zeros((2, 2))}, {"offset": np.zeros(1)}


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        (OFFSET, r"clock has arrays \['offset'\]; it needs \['gain', 'offset'\]"),
        (GAIN | OFFSET | {"more": np.zeros(1)}, "clock has arrays .*'more'"),
        (OFFSET | {"gain": np.zeros((2, 9))}, r"'gain' is float64 \(2, 9\); .* float64 \(2, 2\)"),
        (OFFSET | {"gain": np.zeros((2, 2), np.float32)}, "'gain' is float32"),
        (OFFSET | {"gain": np.full((2, 2), np.nan)}, "'gain' is not finite"),
    ],
    ids=["missing", "extra", "shape", "type", "nan"],
)
def test_damaged_arrays_are_refused(arrays, said):
    CLOCK.check(EstimatorData("clock", GOOD, GAIN | OFFSET), 2, 1)
    refused(said, CLOCK.check, EstimatorData("clock", GOOD, arrays), 2, 1)


def test_one_joint_is_not_two():
    assert families.only_joint("clock", {"offset": (1,)}, 1) == {"offset": (1,)}
    refused("clock estimates one joint, not 2", families.only_joint, "clock", {}, 2)


@pytest.mark.parametrize("name", ["oracle", "", "family", "features", "a.b", "../x", "x" * 99])
def test_a_name_of_no_family_is_refused(name):
    refused("no estimator family .*; update truejoint, or install", families.find_family, name)


def test_a_family_without_a_row_works_offline():
    smoother = replace(CLOCK, row=None, pack=None)
    refused("'clock' uses later rows and cannot run in a loop", smoother.memory,
            EstimatorData("clock", GOOD, {}), 2, 2)  # fmt: skip


def test_rows_are_evaluated_one_after_the_other():
    X, dt = np.array([[1.0], [2.0], [3.0], [4.0]]), [0.0, 0.5, 0.25, 0.0]
    found = families.evaluate(CLOCK, LAYOUT.pack(), X, dt, 2)
    expected = 1e-3 * np.array([0.0, 0.5, 0.75, 0.0]) + 1e-6 * X[:, 0]
    np.testing.assert_allclose(found, np.column_stack([expected, expected]), rtol=1e-15)


def test_a_row_that_gives_up_is_implausible(monkeypatch):
    calibration, sample = trained(), stream(np.zeros(1))[0]
    monkeypatch.setattr(Calibration, "family", replace(CLOCK, row=helpless_row))
    corrector = ready(calibration, on_fault="raw")
    assert corrector.step(0.0, sample) == Status.IMPLAUSIBLE
    np.testing.assert_array_equal(corrector.position, sample[[0, 2]])


def test_a_file_of_an_unknown_family_is_refused_by_name(tmp_path):
    description, arrays = encode(trained())
    description["fit"]["model"]["family"] = "stranger"
    path = tmp_path / "model.safetensors"
    path.write_bytes(to_bytes(description, arrays))
    with pytest.raises(ModelFileError, match=r"model\.safetensors: no estimator family 'stranger'"):
        Corrector(path)
