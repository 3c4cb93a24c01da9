"""The corrector: the same numbers as the calibration, in the loop and without its weight."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from threading import Barrier, Event

import numpy as np
import pytest

from truejoint.calibration import write_calibration
from truejoint.calibration.interval import Interval
from truejoint.errors import CalibrationError, ModelFileError
from truejoint.estimators import NeuralNetwork, Polynomial
from truejoint.runtime import Corrector, Status

from .streams import HISTORY, JOINTS, SIGNALS, ready, recording, run, stream, trained

LOOP = 100.0 + np.arange(0.0, 3.0, 1e-3)


@pytest.fixture(scope="module")
def calibration():
    return trained()


@pytest.mark.parametrize(
    ("estimator", "target", "features"),
    [(NeuralNetwork(hidden_layer_sizes=(9, 7), epochs=2), "position", SIGNALS),
     (Polynomial(3), "error", HISTORY), ("linear", "position", ("effort/elbow",))],
)  # fmt: skip
def test_corrects_bit_for_bit_as_the_calibration(estimator, features, target):
    made = trained(estimator, features, target)
    # Small networks that predict positions are wrong enough to be refused otherwise.
    tolerant = replace(made.training_domain, error_lower=-np.ones(2), error_upper=np.ones(2))
    made = replace(made, training_domain=tolerant)
    # A lag counts samples, so only 30 Hz is as trained; without one the loop may run faster.
    t = LOOP if features != HISTORY else 100.0 + np.arange(0.0, 20.0, 1 / 30)
    moving = recording(t, seed=1)
    expected = made.correct(moving)
    corrector = ready(made, range_margin=1.0)
    samples = np.column_stack([moving.column(signal) for signal in corrector.signals])
    statuses, positions, *_ = run(corrector, t, samples)
    used = statuses == Status.OK
    assert used.mean() > 0.99
    np.testing.assert_array_equal(positions[used], expected[used])
    measured = moving.columns("measured", JOINTS)
    np.testing.assert_array_equal(positions[~used], measured[~used])


def test_shows_what_the_model_says_whatever_the_status(calibration):
    corrector = Corrector(calibration)
    moving = recording(LOOP[:5])
    for t, sample in zip(LOOP[:5], stream(LOOP[:5]), strict=True):
        assert corrector.step(t, sample) == Status.NOT_HOMED
    np.testing.assert_allclose(
        corrector.correction, calibration.predict_error(moving)[-1], rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(corrector.features, stream(LOOP[:5])[-1])


@pytest.mark.parametrize(
    "form", [list, tuple, lambda s: s.astype(np.float32), lambda s: np.repeat(s, 2)[::2]]
)
def test_takes_any_row_of_numbers(calibration, form):
    corrector = ready(calibration)
    sample = stream(LOOP[:1])[0]
    assert corrector.step(np.float32(7), form(sample)) == Status.OK
    expected = sample[[0, 2]] + corrector.correction
    np.testing.assert_allclose(corrector.position, expected, rtol=1e-6)


def interval(rezero: float = 0.0) -> Interval:
    widths = np.array([[0.001, 0.002], [0.003, 0.004]])
    return Interval(
        levels=np.array([0.8, 0.9]), half_widths=widths,
        growth=2.0, rezero=rezero, trajectories=20, homings=1,
    )  # fmt: skip


def test_half_width_is_that_of_the_level_and_grows_outside_the_range(calibration):
    model = replace(calibration, interval=interval())
    middle = 0.5 * (model.lower + model.upper)
    span = model.upper - model.lower
    corrector = ready(model, level=0.8)
    assert corrector.step(0.0, middle) == Status.OK
    np.testing.assert_array_equal(corrector.half_width, [0.001, 0.002])
    corrector = ready(model)
    beyond = middle.copy()
    beyond[0] = model.upper[0] + 0.25 * span[0]
    corrector.step(0.0, beyond)
    assert not corrector.step(0.0, beyond) & Status.OUT_OF_RANGE
    wide = ready(replace(model, training_domain=replace(model.training_domain, distance=1e9)))
    assert wide.step(0.0, beyond) == Status.OK
    np.testing.assert_allclose(wide.half_width, [0.003 * 1.5, 0.004 * 1.5], rtol=1e-12)
    with pytest.raises(CalibrationError, match="99"):
        Corrector(model, level=0.99)
    few = replace(interval(), levels=np.array([0.8]), half_widths=np.array([[0.001, 0.002]]))
    model = replace(calibration, interval=few)  # of too few trajectories for 90 %
    for corrector in (ready(model), ready(model, level=0.8)):
        assert corrector.step(0.0, middle) == Status.OK
        np.testing.assert_array_equal(corrector.half_width, [0.001, 0.002])
    with pytest.raises(CalibrationError, match="90"):
        Corrector(model, level=0.9)


def test_without_an_interval_the_half_width_is_infinite_and_a_level_refused(calibration):
    assert calibration.interval is None
    for ask in (
        partial(Corrector, calibration),
        partial(calibration.correct_table, recording(LOOP[:2])),
    ):
        with pytest.raises(CalibrationError, match="states no interval; make one"):
            ask(level=0.9)
    corrector = ready(calibration)
    assert corrector.step(LOOP[0], stream(LOOP[:1])[0]) == Status.OK
    np.testing.assert_array_equal(corrector.half_width, np.inf)


def test_of_two_threads_one_has_the_corrector(calibration):
    corrector, samples = ready(calibration), stream(LOOP[:2])
    own: list[Status] = []
    other: list[Status] = []

    def step(k: int, said: list[Status]) -> None:
        said.append(corrector.step(float(LOOP[k]), samples[k]))

    with ThreadPoolExecutor(1) as pool:
        step(0, own)
        before = corrector.position.copy()
        pool.submit(step, 1, other).result()
        np.testing.assert_array_equal(corrector.position, before)
        corrector.release()
        pool.submit(step, 1, other).result()
        step(1, own)
    assert other == [Status.OTHER_THREAD, Status.OK]
    step(1, own)  # that thread has ended; the sample has come before
    assert own == [Status.OK, Status.OTHER_THREAD, Status.OK]


def test_threads_at_once_never_see_each_others_sample(calibration):
    corrector, samples = ready(calibration), stream(LOOP[[0, 1500]])
    start, before = Barrier(2), sys.getswitchinterval()

    def refused(k: int) -> int:
        start.wait()
        count = 0
        for i in range(2000):
            if corrector.step(LOOP[0] + 1e-3 * i, samples[k]) & Status.OTHER_THREAD:
                count += 1
            else:
                np.testing.assert_allclose(corrector.position, samples[k, ::2], rtol=0, atol=0.05)
        return count

    assert np.abs(samples[0, ::2] - samples[1, ::2]).max() > 0.1
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as pool:
            assert sorted(pool.map(refused, range(2))) == [0, 2000]
    finally:
        sys.setswitchinterval(before)


def test_another_thread_may_tell_a_homing_and_run_nothing(calibration):
    corrector, samples = ready(calibration), stream(LOOP[:2])
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(corrector.step, LOOP[0], samples[0]).result() == Status.OK
        with pytest.raises(CalibrationError, match="another thread has this corrector"):
            corrector.run(recording(LOOP[:5]))
        assert pool.submit(corrector.step, LOOP[0], samples[0]).result() == Status.OK
        assert corrector.set_homing(False) == Status.NOT_HOMED
        assert corrector.step(LOOP[1], samples[1]) == Status.OTHER_THREAD
        assert pool.submit(corrector.step, LOOP[1], samples[1]).result() == Status.NOT_HOMED
        own = ready(calibration)
        assert own.step(LOOP[1] + 50.0, samples[1]) == Status.OK
        assert not own.run(recording(LOOP[:5])).status.any()  # from a fresh start
        assert own.step(LOOP[0], samples[0]) == Status.OK
        own.set_homing(True, "h1")  # lets go of it
        assert pool.submit(own.step, LOOP[1], samples[1]).result() == Status.OK


def test_a_loop_sees_what_another_thread_tells_between_two_samples_and_whole(calibration):
    corrector, samples = ready(calibration), stream(LOOP)
    plain = run(ready(calibration), LOOP, samples)[1]
    before, told, over = sys.getswitchinterval(), 0, Event()

    def loop() -> np.ndarray:
        seen = np.empty_like(plain)
        for i, sample in enumerate(samples):
            assert corrector.step(float(LOOP[i]), sample) == Status.OK
            seen[i] = corrector.position
        over.set()
        return seen

    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(loop)
            while not over.is_set() and not future.done():
                told += 1
                corrector.rezero([1e-3 * (told % 3), -1e-3 * (told % 3)])
                corrector.acknowledge()
            seen = future.result()
    finally:
        sys.setswitchinterval(before)
    offset = seen - plain
    np.testing.assert_allclose(offset[:, 0], -offset[:, 1], rtol=0, atol=1e-12)
    assert set(np.round(1e3 * offset[:, 0], 6)) <= {0.0, 1.0, 2.0}


def test_rezeroing_adds_an_offset_and_makes_its_interval_hold(calibration):
    corrector = ready(replace(calibration, interval=interval(rezero=10.0)))
    sample = stream(LOOP[:1])[0]
    assert corrector.step(0.0, sample) == Status.OK
    plain = corrector.position.copy()
    np.testing.assert_array_equal(corrector.half_width, np.inf)
    assert corrector.rezero([0.01, -0.02]) == Status.OK
    corrector.step(0.1, sample)
    np.testing.assert_allclose(
        corrector.position, plain + np.array([0.01, -0.02]), rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(corrector.half_width, [0.003, 0.004])
    for wrong in (0.1, [0.1], [0.1, np.nan], [1, 2, 3]):
        with pytest.raises(CalibrationError, match="shoulder, elbow"):
            corrector.rezero(wrong)
    corrector.set_homing(False)
    np.testing.assert_array_equal(corrector.offset, 0.0)


def test_models_that_cannot_be_checked_are_refused(tmp_path, calibration):
    path = tmp_path / "model.safetensors"
    write_calibration(replace(calibration, training_domain=None), path)
    with pytest.raises(ModelFileError, match=r"model\.safetensors: .*calibrate it again"):
        Corrector(path)
    with pytest.raises(ModelFileError, match="absent"):
        Corrector(tmp_path / "absent")
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(ModelFileError, match="damaged"):
        Corrector(path)
    for margin in (-0.1, 1.1, np.nan):
        with pytest.raises(CalibrationError, match="range margin"):
            Corrector(calibration, range_margin=margin)
