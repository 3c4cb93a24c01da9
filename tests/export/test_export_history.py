"""The exported C source of estimators that remember, against their own `step`."""

from __future__ import annotations

import ctypes
import re
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from truejoint.estimators.friction_smoother import SmoothedFrictionFilter

from truejoint.calibration import calibrate
from truejoint.calibration.interval import Interval
from truejoint.errors import ExportError
from truejoint.estimators.friction_filter import FrictionFilter
from truejoint.estimators.jaw_filter import CompensatedJawFilter
from truejoint.export.c_history import FILTER_MEANINGS, filter_context, history_context
from truejoint.export.c_reference import SteppingCorrector
from truejoint.export.export_c import export_c
from truejoint.filters import Gate, UnscentedFilter
from truejoint.filters.sigma_points import LambdaSigmaPoints, ScaledSigmaPoints
from truejoint.filters.status import FilterStatus
from truejoint.motion.forceps_references import calibration_reference, verification_reference
from truejoint.recordings.forceps import record_forceps
from truejoint.runtime import Status
from truejoint.runtime.limits import RANGE_MARGIN
from truejoint.simulation.forceps.specimens import specimen

from .test_export_c import COMPILER, FLAGS, needs_compiler

PLAYS = ("play_motor", "play_reset", "play_both", "play_cables", "play_gated")
FILTERS = ("ukf", "ukf_compensated", "scaled", "signed", "literal", "ukf_friction")

BRIDGE = """
#include "m.c"
#define main check
#include "m_check.c"
#undef main
static m_state kept;
void start(void) { m_init(&kept); m_set_homing(&kept, 1, M_HOMING_OF_CALIBRATION); }
void forget_all(void) { m_reset(&kept); }
int one(double t, const double *sample, double *position, double *half_width)
{
    return m_step(&kept, t, sample, position, half_width);
}
"""
FILTER_BRIDGE = """
int filter_status(void) { return kept.model.filter_status; }
double filter_nis(void) { return kept.model.nis; }
const double *filter_x(void) { return kept.model.x; }
const double *filter_covariance(void) { return kept.model.covariance; }
const double *filter_innovation(void) { return kept.model.innovation; }
int filter_step(const double *z, const double *u, double dt)
{
    return step_filter(&kept.model, z, u, dt);
}
void filter_start(const double *x) { start_filter(&kept.model, x); }
void model_transition(const double *x, const double *u, double dt, double *out)
{
    transition(x, u, dt, out);
}
void model_measurement(const double *x, const double *u, double *out) { measurement(x, u, out); }
void model_noise(double dt, double *out) { process_noise(dt, out); }
"""


@cache
def recordings():
    parameters = specimen("B")
    references = calibration_reference(), verification_reference()
    return tuple(
        record_forceps(parameters, r.positions[:, 0], seed=seed)
        for seed, r in enumerate(references)
    )


@cache
def model(name):
    """Calibration by a name of an estimator, or of a reading of (26); with an interval."""
    if name in ("scaled", "signed", "literal"):
        output = model("ukf_compensated")
        params = output.model.get_params() | {"reading": name}
        other = CompensatedJawFilter.from_arrays(
            params, output.model.to_arrays(), n_features=2, n_outputs=1
        )
        return replace(output, model=other)
    widths = np.full((1, 1), 0.003)
    interval = Interval(np.array([0.9]), widths, widths, widths, 2.0, 0.0, 12, 12)
    return replace(calibrate(recordings()[0], name), interval=interval)


class Library:
    """An exported calibration, compiled."""

    def __init__(self, folder: Path, calibration) -> None:
        export_c(calibration, folder, prefix="m")
        text = BRIDGE
        if "_model;" in (folder / "m.h").read_text() and hasattr(calibration.model, "_filter"):
            text += FILTER_BRIDGE
        (folder / "bridge.c").write_text(text, encoding="ascii")
        path = folder / "library.so"
        command = [COMPILER, *FLAGS, str(folder / "bridge.c"), "-lm", "-o", str(path)]
        subprocess.run(command, check=True)  # noqa: S603  # our own
        self.functions = ctypes.CDLL(str(path))
        self.position, self.half_width = np.empty((2, 1))
        for name in ("filter_x", "filter_covariance", "filter_innovation"):
            if hasattr(self.functions, name):
                getattr(self.functions, name).restype = ctypes.POINTER(ctypes.c_double)
                self.functions.filter_nis.restype = ctypes.c_double

    def step(self, t: float, sample) -> int:
        arrays = (np.ascontiguousarray(sample), self.position, self.half_width)
        return self.functions.one(ctypes.c_double(t), *map(_pointer, arrays))

    def read(self, name: str, count: int):
        return np.array(getattr(self.functions, name)()[:count])


def _pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    @cache
    def build(name: str) -> Library:
        return Library(tmp_path_factory.mktemp(name), model(name))

    return build


def broken_stream(calibration, n: int, seed: int):
    """Stamps and samples of the verification motion with faults of every kind here and there."""
    rng = np.random.default_rng(seed)
    source = recordings()[1]
    t = np.array(source.t[500 : 500 + n])
    samples = source.table[list(calibration.signals)].to_numpy()[500 : 500 + n].copy()
    for row in rng.choice(np.arange(20, n - 20), n // 60, replace=False):
        kind, column = rng.integers(7), rng.integers(samples.shape[1])
        if kind == 0:
            samples[row, column] = rng.choice([np.nan, np.inf, -np.inf])
        elif kind == 1:
            samples[row : row + rng.integers(1, 9)] = np.nan  # a longer step for the model
        elif kind == 2:
            t[row] = rng.choice([np.nan, t[row - 1], t[row - 3]])
        elif kind == 3:
            t[row:] += rng.uniform(0.01, 3.0)
        elif kind == 4:
            t[row:] -= rng.uniform(0.01, 3.0)
        elif kind == 5:
            samples[row, column] *= 1.0 + rng.normal(0, 1.0)
        else:
            samples[row : row + 15, column] = samples[row, column]
    return t, samples


def stepping(calibration) -> SteppingCorrector:
    corrector = SteppingCorrector(calibration, level=0.9, range_margin=RANGE_MARGIN)
    corrector.set_homing(True, calibration.metadata["homing_ids"][0])
    return corrector


@needs_compiler
@pytest.mark.parametrize("name", PLAYS + FILTERS)
def test_source_passes_its_own_check(library, name):
    assert library(name).functions.check() == 0


@needs_compiler
@pytest.mark.parametrize("name", PLAYS + FILTERS)
def test_long_broken_streams_stay_equal(library, name):
    calibration, exported = model(name), library(name)
    t, samples = broken_stream(calibration, 4000, 5)
    corrector = stepping(calibration)
    exported.functions.start()
    statuses, filter_bits = [], 0
    for row in range(len(t)):
        status = exported.step(t[row], samples[row])
        assert corrector.step(t[row], samples[row]) == status, row
        np.testing.assert_allclose(exported.position, corrector.position, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(exported.half_width, corrector.half_width, rtol=1e-12)
        statuses.append(status)
        if name in FILTERS:
            assert exported.functions.filter_status() == corrector.filter_status, row
            filter_bits |= corrector.filter_status
    assert 0.3 < np.mean(np.array(statuses) == 0) < 0.98
    assert np.bitwise_or.reduce(statuses) & (Status.NOT_FINITE | Status.TIME_JUMP | Status.SPIKE)
    if name in FILTERS and name != "ukf_friction":
        assert filter_bits == FilterStatus.PARTIAL  # the first sample of each history


@needs_compiler
@pytest.mark.parametrize("name", ["play_gated", "ukf_compensated", "ukf_friction"])
def test_reset_forgets_the_history(library, name):
    calibration, exported = model(name), library(name)
    t, samples = broken_stream(calibration, 600, 1)

    def run(rows):
        return [(exported.step(t[i], samples[i]), exported.position[0]) for i in rows]

    exported.functions.start()
    fresh = run(range(300, 600))
    exported.functions.start()
    run(range(300))
    exported.functions.forget_all()
    np.testing.assert_array_equal(run(range(300, 600)), fresh)


@pytest.mark.parametrize("name", PLAYS + FILTERS)
def test_reference_gives_the_numbers_of_the_calibration(name):
    calibration, source = model(name), recordings()[1].rows(np.arange(1500))
    corrector = stepping(calibration)
    samples = source.table[list(calibration.signals)].to_numpy()
    expected = calibration.correct(source)
    good = 0
    for row in range(len(source)):
        if corrector.step(source.t[row], samples[row]) == Status.OK:
            good += 1
            assert corrector.position[0] == expected[row, 0]
    assert good > (150 if name in ("play_motor", "play_cables") else 700)


def random_model_input(rng, n: int, inputs: int):
    size = 10.0 ** rng.uniform(-6, 2)
    return rng.normal(0, size, n), rng.normal(0, size, inputs), 10.0 ** rng.uniform(-4, 0)


@needs_compiler
@pytest.mark.parametrize("name", ["ukf", "ukf_friction"])
def test_model_functions_are_those_of_python(library, name):
    space, functions = model(name).model._filter.model, library(name).functions
    n, m, inputs = len(space.states), len(space.measurements), len(space.inputs)
    theta, rng = np.asarray(space.parameters), np.random.default_rng(3)
    for _ in range(300):
        x, u, dt = random_model_input(rng, n, inputs)
        expected, got = np.empty((2, n))
        space.transition.py_func(x, u, dt, theta, expected)
        functions.model_transition(_pointer(x), _pointer(u), ctypes.c_double(dt), _pointer(got))
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
        expected, got = np.empty((2, m))
        space.measurement.py_func(x, u, theta, expected)
        functions.model_measurement(_pointer(x), _pointer(u), _pointer(got))
        np.testing.assert_allclose(got, expected, rtol=1e-12)
        expected, got = np.zeros((2, n, n))
        space.process_noise.py_func(x, u, dt, theta, expected)
        functions.model_noise(ctypes.c_double(dt), _pointer(got))
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def garbage(rng, size: int, ordinary):
    """Mostly ordinary numbers, some that no filter can use."""
    values = rng.normal(0.0, ordinary, size)
    bad = rng.random(size) < 0.02
    choices = [np.nan, np.inf, -np.inf, 1e99, -1e120, 1e60, 0.0]
    return np.where(bad, rng.choice(choices, size), values)


def compare_on_garbage(estimator, spread, exported, rows: int) -> int:
    """Step a filter and its C source alike; returns the status bits that were seen."""
    functions, space = exported.functions, estimator.model
    n, m, inputs = len(space.states), len(space.measurements), len(space.inputs)
    rng = np.random.default_rng(7)
    x0, seen = np.zeros(n), 0
    for k in range(rows):
        if k % 500 == 0:  # what is far out stays far out
            state = estimator.initial_state(x0, spread)
            functions.filter_start(_pointer(x0))
        z, u = garbage(rng, m, 1e-4), garbage(rng, inputs, 1e-5)
        dt = float(rng.choice([5e-3, 0.02, 0.0, 1e120, -1.0, np.nan],
                              p=[0.9, 0.06, 0.025, 0.005, 0.005, 0.005]))  # fmt: skip
        status = estimator.step(state, z, u, dt)
        assert functions.filter_step(_pointer(z), _pointer(u), ctypes.c_double(dt)) == status, k
        seen |= status
        size = np.sqrt(np.diag(state.P)).max()
        x, P = exported.read("filter_x", n), exported.read("filter_covariance", n * n)
        np.testing.assert_allclose(x, state.x, rtol=1e-12, atol=1e-12 * size)
        np.testing.assert_allclose(P, state.P.ravel(), rtol=1e-12, atol=1e-12 * size**2)
        innovation = exported.read("filter_innovation", m)
        np.testing.assert_allclose(innovation, state.innovation, rtol=1e-12)
        np.testing.assert_allclose(functions.filter_nis(), state.nis, rtol=1e-12)
    return seen


UNUSABLE = FilterStatus.MISSING | FilterStatus.INVALID_INPUT | FilterStatus.INVALID_MEASUREMENT


@needs_compiler
@pytest.mark.parametrize(
    ("name", "more"),
    [
        (
            "ukf",
            FilterStatus.PARTIAL | FilterStatus.TRANSITION_FAILED | FilterStatus.OUT_OF_RANGE,
        ),
        ("ukf_friction", FilterStatus.MEASUREMENT_FAILED),
    ],
)
def test_filters_survive_garbage_alike(library, name, more):
    estimator = model(name).model._filter
    spread = history_context(model(name).model)[1]["first_covariance"]
    seen = compare_on_garbage(estimator, spread, library(name), 10000)
    wanted = UNUSABLE | more
    assert seen & wanted == wanted


@needs_compiler
@pytest.mark.parametrize(
    ("points", "more"),
    [
        (LambdaSigmaPoints(-4.5), FilterStatus.COVARIANCE_REPAIRED),
        (ScaledSigmaPoints(1.0, 1.0), FilterStatus.OK),
        (ScaledSigmaPoints(1e-3), FilterStatus.OK),
    ],
)
def test_any_sigma_points_have_source(tmp_path, points, more):
    """Centre terms that are subtracted, absent and added."""
    original = model("ukf_friction")
    friction = FrictionFilter.from_arrays(
        original.model.get_params(), original.model.to_arrays(), n_features=2, n_outputs=1
    )
    friction._filter = UnscentedFilter(friction._filter.model, points)
    exported = Library(tmp_path, replace(original, model=friction))
    assert exported.functions.check() == 0
    spread = friction._prior()[1]
    assert compare_on_garbage(friction._filter, spread, exported, 2000) & more == more


def test_header_explains_every_status_of_a_filter():
    never = {FilterStatus.GATED, FilterStatus.REACQUIRED}
    assert set(FILTER_MEANINGS) == {FilterStatus.OK, *FilterStatus} - never


def test_estimators_without_source_are_refused_in_one_line(tmp_path):
    original = model("ukf_friction")
    smoothed = SmoothedFrictionFilter.from_arrays(
        original.model.get_params(), original.model.to_arrays(), n_features=2, n_outputs=1
    )
    cases = [
        (replace(original, model=smoothed), "uses later rows"),
        (calibrate(recordings()[0], "lsm"), "'lsm' has no C source"),
    ]
    for bad, said in cases:
        with pytest.raises(ExportError, match=said) as caught:
            export_c(bad, tmp_path)
        assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_single_precision_of_a_filter_is_refused(tmp_path):
    with pytest.raises(ExportError, match=r"'ukf' holds .* in double"):
        export_c(model("ukf"), tmp_path, precision="float")


@needs_compiler
@pytest.mark.parametrize("name", PLAYS)
def test_single_precision_is_as_far_off_as_its_header_says(tmp_path, name):
    export_c(model(name), tmp_path, prefix="m", precision="float")
    sources = [str(tmp_path / source) for source in ("m.c", "m_check.c")]
    program = str(tmp_path / "check")
    flags = [flag for flag in FLAGS if flag not in ("-shared", "-fPIC")]
    subprocess.run([COMPILER, *flags, *sources, "-lm", "-o", program], check=True)  # noqa: S603
    said = subprocess.run([program], check=True, capture_output=True, text=True).stdout  # noqa: S603
    measured = float(re.search(r"largest difference (\S+)", said)[1])
    stated = float(re.search(r"within (\S+) \(rad", (tmp_path / "m.h").read_text())[1])
    assert 1e-10 < measured < 1e-5
    assert stated == pytest.approx(measured, rel=0.5)


@pytest.mark.parametrize(
    "options", [{"second_generation": False}, {"square_root": True}, {"gate": Gate()}]
)
def test_options_without_source_are_refused(options):
    space = model("ukf").model._filter.model
    with pytest.raises(ExportError, match="no square-root form, no gate"):
        filter_context(UnscentedFilter(space, **options), np.eye(4))
