"""Fault injection: each row of docs/status.md, and streams of anything."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from truejoint.runtime import Corrector, Status
from truejoint.runtime.limits import limits_of

from . import streams
from .streams import (
    FAULT,
    FEATURES,
    HISTORY,
    MEASURED,
    MINUTE,
    RATE,
    SIGNALS,
    changed,
    ready,
    recording,
    remembering,
    run,
    stream,
    trained,
)

T = streams.T[: 6 * RATE]


@pytest.fixture(scope="module")
def calibration():
    return remembering()


@pytest.fixture
def corrector(calibration):
    return ready(calibration, on_fault="raw")


@dataclass(frozen=True)
class Fault:
    """A fault put into a clean stream, and what must become of it.

    `put` changes stamps and samples in place; flagged rows carry `status` and lie within the
    `seen` seconds after `FAULT`, the first of them at most `late` after it. With `traceless`, all
    other rows are corrected as if the flagged ones had never come; without, within half a second.
    """

    status: Status
    put: Callable[[np.ndarray, np.ndarray], None]
    seen: float = 1 / RATE
    late: float = 0.0
    traceless: bool = True


class Odd:
    """What raises whatever is asked of it, but for its name, by which a test is called."""

    def __repr__(self) -> str:
        return "Odd()"

    def __len__(self) -> int:
        raise RuntimeError

    def __getattr__(self, name: str) -> object:
        raise OSError

    def __float__(self) -> float:
        raise MemoryError


def value(signal: int, number: float, rows: int = 1):
    return changed(signal, lambda _: number, rows)


def shifted(by: float, rows: int | None = None):
    return changed("t", lambda t: t + by, rows)


def held(*signals: int):
    return changed(signals, lambda part: part[0], 2500)


def slowly_to_one_and_back(part: np.ndarray) -> np.ndarray:
    """Slowly enough to be no spike."""
    return part + np.sin(np.linspace(0.0, np.pi, len(part))) ** 2 * (1.0 - part)


FAULTS = {
    "NaN in an effort": Fault(Status.NOT_FINITE, value(1, np.nan)),
    "NaN in a position for a while": Fault(Status.NOT_FINITE, value(2, np.nan, 50), 0.05),
    "infinite position": Fault(Status.NOT_FINITE, value(0, np.inf)),
    "NaN stamp": Fault(Status.NOT_FINITE, shifted(np.nan, 1)),
    "stamp that stands still": Fault(
        Status.STALE, changed("t", lambda _: T[FAULT - 1], 30), 0.03, late=0.011
    ),
    "stamp of the past": Fault(Status.STALE, shifted(-0.1, 20), 0.02, late=0.011),
    "clock set back a little": Fault(
        Status.STALE, shifted(-0.1), 0.101, late=0.011, traceless=False
    ),
    "clock set back": Fault(Status.TIME_JUMP, shifted(-100.0), traceless=False),
    "clock set forward": Fault(Status.TIME_JUMP, shifted(100.0), traceless=False),
    "spike in a position": Fault(Status.SPIKE, value(0, 0.9)),
    "spike in an effort": Fault(Status.SPIKE, value(3, -0.6)),
    "position slipped for a while": Fault(Status.SPIKE, value(0, 0.85, 200), 0.2),
    "one position frozen": Fault(Status.FROZEN, held(0), 2.5, late=1.5, traceless=False),
    "one effort frozen": Fault(Status.FROZEN, held(3), 2.5, late=1.5, traceless=False),
    "all frozen": Fault(Status.FROZEN, held(0, 1, 2, 3), 2.5, late=1.1, traceless=False),
    "far out of range": Fault(Status.OUT_OF_RANGE, value(0, 1e200)),
    "slowly out of range": Fault(
        Status.OUT_OF_RANGE, changed(0, slowly_to_one_and_back, 2500), 2.5, late=1.25,
        traceless=False,
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_fault_is_flagged_passed_through_and_recovered_from(calibration, corrector, fault):
    t, samples = T.copy(), stream(T)
    fault.put(t, samples)
    bits, positions, widths, _ = run(corrector, t, samples)
    flagged = (bits & fault.status) != 0
    assert not bits[:FAULT].any()
    first = int(np.argmax(flagged))
    assert FAULT <= first <= FAULT + fault.late * RATE
    np.testing.assert_array_equal(positions[bits != 0], samples[:, MEASURED][bits != 0])
    assert np.isinf(widths[bits != 0]).all()
    over = FAULT + round(fault.seen * RATE)
    assert not flagged[over:].any()
    assert not (bits & Status.ZERO_SUSPECT).any()
    assert not bits[over + RATE // 2 :].any()
    if fault.traceless:
        assert not bits[over:].any()
        newest = np.fmax.accumulate(np.concatenate([[-np.inf], t[:-1]]))
        kept = (bits == 0) & (t > newest)  # messages that come again are put out, no more
        clean = calibration.correct(on_stream(t[kept], samples[kept]))
        np.testing.assert_array_equal(positions[kept], clean)


def on_stream(t: np.ndarray, samples: np.ndarray):
    """Recording of these samples."""
    made = recording(t)
    table = made.table.copy()
    table[list(SIGNALS)] = samples
    return replace(made, table=table)


def test_slipped_position_is_taken_when_the_joint_could_have_moved_there(corrector, calibration):
    t, samples = T.copy(), stream(T)
    samples[FAULT:, 0] += 0.15
    t[FAULT // 2] = t[FAULT // 2 - 1]  # a message late in good time before
    bits, *_ = run(corrector, t, samples)
    limits = limits_of(calibration)
    needed = 0.15 / (limits.reach[0] / limits.training_dt)
    spikes = np.flatnonzero(bits & Status.SPIKE)
    assert spikes[0] == FAULT
    assert needed * 0.5 < T[spikes[-1]] - T[FAULT] < needed * 2.0
    assert len(spikes) == spikes[-1] - spikes[0] + 1
    assert (bits[spikes[-1] + 1 :] & Status.ZERO_SUSPECT).all()
    corrector.acknowledge()
    assert not corrector.step(T[-1] + 1.0 / RATE, samples[-1]) & Status.ZERO_SUSPECT


def test_a_motion_faster_than_any_in_training_is_no_slip(corrector, calibration):
    limits = limits_of(calibration)
    t = limits.training_dt * np.arange(120)
    samples, phase = stream(t), np.maximum(0.4 * (np.arange(120) - 40), 0.0)
    samples[40:, 0] = samples[40, 0]
    samples[:, 0] += 2.0 * limits.reach[0] / 0.4 * (1.0 - np.cos(phase))
    bits, *_ = run(corrector, t, samples)
    assert (bits & Status.SPIKE).any()
    assert not (bits & Status.ZERO_SUSPECT).any()


def test_a_jump_too_small_for_the_rate_of_training_is_seen_at_that_of_the_loop(corrector):
    samples = stream(T)
    samples[FAULT:, 0] += 0.008  # the shoulder moves by as much from one row of training to another
    bits, *_ = run(corrector, T, samples)
    assert not bits[:FAULT].any()
    assert bits[FAULT] == Status.SPIKE
    assert bits[-1] & Status.ZERO_SUSPECT


def test_a_feature_that_the_distance_leaves_out_is_held_to_its_range(calibration):
    seen = calibration.training_domain
    left_out = replace(seen, whitening=seen.whitening * [0.0, *np.ones(len(seen.feature_mean) - 1)])
    changed, plain = (
        limits_of(model) for model in (replace(calibration, training_domain=left_out), calibration)
    )
    assert np.isfinite(changed.feature_lower[0])
    np.testing.assert_array_equal(changed.feature_lower, plain.feature_lower)


def test_features_unlike_any_trained_row_together(calibration):
    low, high = calibration.lower, calibration.upper
    rows = stream(T)
    usual = rows[np.argmin(rows[:, 0])].copy()
    usual[0] = low[0] + 0.02
    odd = usual.copy()
    odd[:2] = low[:2] + 0.02  # the effort of the other end
    for sample, expected in ((usual, Status.OK), (odd, Status.OUT_OF_DOMAIN), (usual, Status.OK)):
        assert (low[:4] <= sample).all()
        assert (sample <= high[:4]).all()
        corrector = ready(calibration)
        assert corrector.step(0.0, sample) == expected


def test_corrections_larger_than_any_error_of_training():
    made = trained()
    data = made.fitted
    steep = replace(data, arrays={**data.arrays, "coef": 4.0 * data.arrays["coef"]})
    wrong = replace(made, fitted=steep)
    corrector = ready(wrong, on_fault="raw")
    samples = stream(T)
    bits, positions, *_ = run(corrector, T, samples)
    assert set(np.unique(bits)) == {0, Status.IMPLAUSIBLE}
    assert (np.diff((bits == 0).astype(int)) == 1).any()  # recovered at least once
    corrections = wrong.predict_error(recording(T))
    limits = limits_of(wrong)
    within = (corrections >= limits.correction_lower) & (corrections <= limits.correction_upper)
    np.testing.assert_array_equal(bits == 0, within.all(axis=1))
    np.testing.assert_array_equal(positions[bits != 0], samples[:, MEASURED][bits != 0])


NO_SAMPLES = (
    (), (1.0,), (0.5,) * 3, (0.5,) * 5, np.zeros((4, 4)), np.zeros((4, 0)), 3.0, None, "abcd",
    ("a", "b", "c", "d"), (10**400,) * 4, np.array(0.5), {"a": 1}, np.full(4, 0.5 + 0j),
    (0.5, 0.5, 0.5, 0.5j), np.ma.array(np.full(4, 0.5), mask=[0, 1, 0, 0]), Odd(),
)  # fmt: skip
NO_STAMPS = ("noon", "1.0", (), 10**400, 1j, np.complex128(1j), Odd())


@pytest.mark.parametrize(
    ("stamp", "sample"),
    [*((0.001, sample) for sample in NO_SAMPLES), *((t, stream(T[:1])[0]) for t in NO_STAMPS)],
    ids=repr,
)
def test_what_is_not_a_number_for_each_signal(corrector, stamp, sample):
    good = stream(T[:3])
    assert corrector.step(0.0, good[0]) == Status.OK
    corrector.half_width[:] = 0.1  # as of a model that knows one
    assert corrector.step(stamp, sample) == Status.WRONG_SIZE
    assert np.isnan(corrector.position).all()
    assert np.isinf(corrector.half_width).all()
    assert corrector.step(0.002, good[2]) == Status.OK


def test_a_robot_that_holds_still_is_not_frozen(corrector):
    samples = stream(T)
    still = slice(FAULT, FAULT + 4000)
    samples[still, [0]] = samples[FAULT, 0]
    samples[still, [2]] = samples[FAULT, 2]
    noise = np.random.default_rng(5).uniform(-0.02, 0.02, (4000, 2))
    samples[still, 1::2] = 0.4 * np.cos(3.0 * samples[still, ::2]) + noise
    bits, *_ = run(corrector, T[: still.stop], samples[: still.stop])
    assert not bits.any()


def test_a_model_that_counts_samples_corrects_at_no_faster_rate():
    corrector = ready(trained(features=HISTORY), on_fault="raw")
    bits, positions, *_ = run(corrector, T[:500], stream(T[:500]))
    used = np.flatnonzero(bits == 0)
    assert (np.diff(T[used]) > 0.02).all()
    assert (np.delete(bits, used) == Status.STALE).all()
    np.testing.assert_array_equal(
        np.delete(positions, used, 0), np.delete(stream(T[:500])[:, MEASURED], used, 0)
    )
    trained_rate = np.arange(1.0, 10.0, 1 / 30)
    bits, *_ = run(corrector, trained_rate, stream(trained_rate))
    assert not bits[1:].any()


def test_a_model_that_counts_samples_corrects_at_no_slower_rate():
    for steps, flagged in ((1.45, 0), (1.55, 278), (3.0, 278), (9.0, 278), (11.0, 299)):
        t = 1.0 + steps / 30 * np.arange(300)
        bits = corrected_with_lags(t)
        assert (bits & Status.TIME_JUMP > 0).sum() == flagged
        assert (bits[-flagged:] == Status.TIME_JUMP).all() or not flagged
        every = ready(trained())  # which counts nothing
        assert steps > 10.0 or not run(every, t, stream(t))[0].any()


def test_stamps_that_jitter_and_samples_that_are_lost_are_no_slower_rate():
    rng = np.random.default_rng(0)
    even = np.arange(3000)
    lost = even[rng.random(3000) > 0.2]
    jittered = even + rng.uniform(-0.45, 0.45, 3000), np.cumsum(rng.uniform(0.5, 1.5, 3000))
    for count in (*jittered, lost):
        bits = corrected_with_lags(1.0 + count / 30)
        assert not (bits & Status.TIME_JUMP).any()
        assert (bits == 0).mean() > 0.7


@pytest.fixture(scope="module")
def fast():
    """A model that remembers, trained at 1 kHz."""
    return trained(features=FEATURES, recordings=[recording(np.arange(0.0, 20.0, 1e-3))])


@pytest.mark.parametrize(("gap", "flagged"), [(0.05, 0), (0.29, 0), (0.31, 1), (2.0, 1)])
def test_what_a_history_bridges_is_a_time_and_no_number_of_samples(fast, gap, flagged):
    corrector = ready(fast)
    t = np.arange(0.0, 2.0, 1e-3)
    t[1000:] += gap
    bits = run(corrector, t, stream(t))[0]
    assert (bits & Status.TIME_JUMP > 0).sum() == flagged
    assert flagged or not bits.any()
    slow = 0.02 * np.arange(200)  # a loop at a twentieth of the rate
    corrector = ready(fast)
    assert (run(corrector, slow, stream(slow))[0] & Status.TIME_JUMP > 0).sum() == 178


def corrected_with_lags(t: np.ndarray) -> np.ndarray:
    """Status bits of the stream at stamps, by a model that counts samples at 30 Hz."""
    corrector = ready(trained(features=HISTORY))
    return run(corrector, t, stream(t))[0]


def test_a_channel_that_never_changed_in_training_may_stand_still_or_not():
    corrector = ready(trained(features=(*SIGNALS, "effort/unused")))
    rows = np.column_stack([stream(T), np.zeros(len(T))])
    rows[2000:, 4] = 7.0
    bits, positions, *_ = run(corrector, T, rows)
    assert not bits.any()
    plain = ready(trained())
    np.testing.assert_allclose(positions, run(plain, T, stream(T))[1], rtol=0, atol=1e-12)


def test_a_position_that_never_changed_in_training_is_flagged_where_it_is_elsewhere():
    held = recording(MINUTE)
    columns = {"measured/insertion": "m", "measured/tool_roll": "rad"}
    table = held.table.assign(**dict.fromkeys(columns, 0.3))
    still = replace(held, table=table, units={**held.units, **columns})
    features = (*SIGNALS, "measured/insertion", "measured/tool_roll")
    corrector = ready(trained(features=features, recordings=[still]))
    rows = np.column_stack([stream(T), np.full((len(T), 2), 0.3)])
    rows[1000:, 4] = 0.2  # the only length: by how much it may move is not known
    rows[2000:, 5] += 0.03
    rows[3000:, 5] += 0.02
    bits, *_ = run(corrector, T, rows)
    assert not bits[:3000].any()
    assert (bits[3000:] & Status.OUT_OF_RANGE).all()


@pytest.mark.parametrize(
    ("known", "told", "expected"),
    [("h1", "", Status.NOT_HOMED), ("h1", "lost", Status.NOT_HOMED), ("h1", "h1", Status.OK),
     ("h1", "some", Status.OK), ("h1", "h1 some", Status.OK), ("h1", "lost h1", Status.OK),
     ("h1", "h2 h1", Status.OK), ("h1", "h2", Status.HOMED_AGAIN),
     ("h1", "h2 some", Status.HOMED_AGAIN), ("h1", "lost some", Status.HOMED_AGAIN),
     ("h1", "some lost some", Status.HOMED_AGAIN),
     # One that is re-zeroed is believed until another homing is told, which ends the offset.
     ("h1", "lost rezeroed", Status.NOT_HOMED), ("h1", "h2 rezeroed", Status.OK),
     ("h1", "h2 rezeroed h2", Status.OK), ("h1", "h2 rezeroed lost h2", Status.HOMED_AGAIN),
     ("h1", "h2 rezeroed some", Status.OK), ("h1", "h2 rezeroed h3 h3", Status.HOMED_AGAIN),
     ("h1", "h2 rezeroed h3 h2", Status.HOMED_AGAIN), ("h1 h2", "h1 rezeroed h2", Status.OK),
     # Where the training names none, the first one told is its homing.
     ("", "a", Status.OK), ("", "a b", Status.HOMED_AGAIN), ("", "a b rezeroed b", Status.OK)],
)  # fmt: skip
def test_homing(calibration, known, told, expected):
    """Recordings of `known` homings; of ``some`` homing no name is told."""
    origin = replace(calibration.origin, homing_ids=tuple(known.split()))
    corrector = Corrector(replace(calibration, origin=origin))
    status, homing, rezeroed = None, "", ""
    for word in told.split():
        if word == "rezeroed":
            status, rezeroed = corrector.rezero([0.01, 0.0]), homing
        else:
            status = corrector.set_homing(word != "lost", word if word[:-1] in ("h", "") else None)
            homing, rezeroed = word, rezeroed if word in (rezeroed, "some") else ""
        assert corrector.offset[0] == (0.01 if rezeroed else 0.0)
    sample = stream(T[:1])[0]
    assert corrector.step(0.0, sample) == expected
    assert status in (expected, None)
    if expected:
        np.testing.assert_array_equal(corrector.position, sample[MEASURED])


def test_homing_starts_the_history_anew(corrector):
    corrector.step(100.0, stream(T[:1])[0])
    corrector.set_homing(False)
    corrector.set_homing(True, "h1")
    assert corrector.step(0.0, stream(T[-1:])[0]) == Status.OK


def test_documentation_has_a_row_for_every_status():
    page = Path(__file__, "../../../docs/status.md").resolve().read_text("utf-8")
    for status in Status:
        assert f"| `{status.name}` |" in page


NUMBERS = st.one_of(
    st.floats(), st.floats(0.2, 0.8), st.sampled_from([0.0, 1e308, -1e308, 5e-324, 1.5])
)
STEPS = st.one_of(
    st.sampled_from([1e-3, 1e-3, 1 / 30, 0.0, -1e-3, 1e-9, 1e6, -1e6]), st.floats()
)  # fmt: skip


@given(
    st.lists(
        st.tuples(STEPS, st.lists(NUMBERS, min_size=3, max_size=5), st.booleans()), max_size=40
    )
)
@example([(0.001, [0.0] * 4, False)])
@settings(max_examples=60, deadline=None)
def test_streams_of_anything(shared, steps):
    calibration, corrector = shared
    limits = limits_of(calibration)
    corrector.set_homing(False)
    corrector.set_homing(True, "h1")
    t, last = 0.0, None
    for step, numbers, clean in steps:
        t += step
        sample = stream(np.array([t]))[0] if clean and abs(t) < 1e6 else np.array(numbers)
        status = corrector.step(t, sample)
        if len(sample) != len(SIGNALS):
            assert status == Status.WRONG_SIZE
            t = t if np.isfinite(t) else 0.0
            continue
        raw = sample[MEASURED]
        if status == Status.OK:
            assert np.isfinite(sample).all()
            assert (sample >= limits.signal_lower).all()
            assert (sample <= limits.signal_upper).all()
            late = last is not None and -limits.longest <= t - last < limits.shortest
            assert last is None or late or t - last <= limits.longest
            assert np.isfinite(corrector.position).all()
            difference = corrector.position - raw
            assert (difference >= limits.correction_lower - 1e-12).all()
            assert (difference <= limits.correction_upper + 1e-12).all()
        else:
            np.testing.assert_array_equal(corrector.position, raw)
            assert np.isinf(corrector.half_width).all()
        if not np.isfinite(t):
            t = 0.0 if last is None else last
        elif not status & Status.STALE:
            last = t if last is None or t < last - limits.longest else max(last, t)
    # A wild sample may have been believed: the next is where the joint can be by then.
    way_back = ((limits.signal_upper - limits.signal_lower) / limits.reach).max()
    settled = way_back * limits.training_dt + 0.5
    clean = np.arange(0.0, settled + 1.0, 1e-2)
    bits, positions, *_ = run(corrector, clean, stream(clean))
    # A zero that is suspect stays so; see the row of ZERO_SUSPECT.
    assert not (bits[clean > settled] & ~Status.ZERO_SUSPECT).any()
    assert np.isfinite(positions).all()


@pytest.fixture(scope="module")
def shared(calibration):
    return calibration, Corrector(calibration, on_fault="raw")
