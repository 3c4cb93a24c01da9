"""Every registered estimator in the loop: the numbers of the calibration, whatever the stream."""

import copy
import fnmatch
import subprocess
import sys
from dataclasses import replace
from functools import partial
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.estimators.motor_side.test_motor_side import estimate

from truejoint.calibration import write_calibration
from truejoint.calibration.interval import Interval
from truejoint.calibration.model_file import encode, to_bytes
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, ModelFileError
from truejoint.estimators import get_estimator
from truejoint.features.feature_set import time_steps
from truejoint.recordings import Recording
from truejoint.runtime import Corrector, Status

from .registered import ALIKE, forceps, in_loop, model, ready, unseen, unseen_samples
from .streams import faulty, least_memory, run

HEAVY = (
    "sklearn", "pandas", "pyarrow", "plotly", "matplotlib", "jinja2", "scipy.linalg",
    "scipy.spatial", "scipy.stats",
    "truejoint.estimators.base", "truejoint.recordings",
)  # fmt: skip
CAUSAL = tuple(in_loop())
FAMILIES = {name: get_estimator(name).family for name in CAUSAL}
FILTERS = tuple(n for n in CAUSAL if n.startswith("ukf"))


def states_width(name: str) -> bool:
    states = FAMILIES[name].states_deviation
    return states is not None and states(get_estimator(name).model_params())


WITH_WIDTH = tuple(filter(states_width, CAUSAL))
APART = tuple(n for n in CAUSAL if n not in ALIKE | {"linear", "poly2", "lsm_intercept"})
"""Without those that differ from `poly2_ridge`, `lsm` and others by their numbers alone."""


def restamped(recording: Recording, t, **changed) -> Recording:
    columns = {c: np.array(recording.table[c]) for c in recording.table.columns} | {"t": t}
    columns |= changed
    return Recording.from_columns(columns, recording.provenance, dict(recording.units))


@pytest.mark.parametrize("name", APART)
def test_a_broken_stream_gives_the_numbers_of_its_good_rows(name, tmp_path):
    calibration, recording, clean = unseen_samples(name, 1200)
    path = tmp_path / "model.safetensors"
    write_calibration(calibration, path)
    t, samples = faulty(recording.t, clean, seed=3, kinds=(0, 1, 2, 4))
    statuses, positions, widths, corrections = run(
        ready(path, range_margin=1.0, on_fault="raw"), t, samples
    )
    used = np.isfinite(corrections[:, 0])
    assert 0.9 < used.mean() < 1.0
    taken = dict(zip(calibration.loop_signals, samples[used].T, strict=True))
    rest = restamped(recording.rows(np.flatnonzero(used)), t[used], **taken)
    expected = calibration.correct(rest)
    histories = (time_steps(t[used], calibration.gap_limit) == 0.0).sum()
    assert histories > 2
    joints = calibration.joints
    # A difference of corrected and measured is rounded once more than the corrected itself.
    np.testing.assert_allclose(
        corrections[used], expected - rest.columns("measured", joints), rtol=0, atol=1e-12
    )
    good = statuses[used] == Status.OK
    assert good.mean() > 0.5
    assert np.isfinite(widths[used][good]).all() == (name in WITH_WIDTH)
    assert np.isinf(widths[statuses != 0]).all()
    np.testing.assert_array_equal(positions[used][good], expected[good])
    measured = samples[:, [calibration.loop_signals.index(f"measured/{j}") for j in joints]]
    np.testing.assert_array_equal(positions[statuses != 0], measured[statuses != 0])


RECOVERY = 1.0  # s of motion, after which a filter is back; stated in docs/status.md


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_recovers_from_a_burst_and_says_so_meanwhile(name):
    calibration, good, table = unseen_samples(name, 1400)
    rows = int(1.2 * calibration.gap_limit / np.median(np.diff(good.t)))  # of no history
    burst, clean = slice(1150 - rows, 1150), calibration.correct(good)
    later = good.t > good.t[burst.stop] + RECOVERY
    for size in (1e20, 1e3):
        samples = table.copy()
        noise = np.random.default_rng(0).normal(size=(rows, table.shape[1]))
        samples[burst] += size * noise * np.ptp(table, axis=0)
        columns = dict(zip(calibration.loop_signals, samples.T, strict=True))
        bad = Recording(good.table.assign(**columns), good.units, good.provenance)
        corrected = calibration.correct(bad)
        assert np.isnan(corrected[burst]).mean() > 0.8  # no estimate, rather than a wrong one
        assert np.abs(corrected - clean)[later].max() < 1e-3
        # In the loop the burst never gets as far as the filter, which starts anew after it.
        statuses, positions, widths, _ = run(ready(calibration, on_fault="raw"), good.t, samples)
        assert (statuses[burst] != 0).all()
        assert not statuses[burst.stop :].any()
        assert np.abs(positions - clean)[later].max() < 1e-3
        if name in WITH_WIDTH:
            assert widths[burst.stop, 0] > 1.01 * widths[burst.start - 1, 0]


@pytest.mark.parametrize("name", CAUSAL)
def test_a_step_allocates_nothing(name):
    calibration, recording, samples = unseen_samples(name)
    corrector, stamps, samples = ready(calibration), recording.t.tolist(), list(samples)
    for i in range(100):
        corrector.step(stamps[i], samples[i])
    arrays = [getattr(corrector, n) for n in ("position", "half_width", "correction", "features")]
    places = [array.ctypes.data for array in arrays]

    def go_on(first: int) -> None:
        for i in range(first, first + 300):
            corrector.step(stamps[i], samples[i])

    assert least_memory(partial(go_on, first) for first in (100, 400, 700))[0] < 1000
    assert places == [array.ctypes.data for array in arrays]


@pytest.mark.parametrize("name", ["poly2_ridge", "rich_trees", "gru", "ukf_elastic"])
@pytest.mark.parametrize("fault", ["nan", "ahead", "back"])
def test_it_recovers_as_if_it_began_there(name, fault):
    calibration, recording, samples = unseen_samples(name)
    t, samples = np.array(recording.t), samples.copy()
    gap, half = 1.5 * calibration.gap_limit, 700
    dt = float(np.median(np.diff(t)))
    if fault == "nan":
        end = half + 2 + int(gap / dt)
        samples[half:end] = np.nan
    else:
        end = half
        t[half:] += gap + 1.0 if fault == "ahead" else -(t[half] - t[0] + gap + 1.0)
    corrector = ready(calibration, range_margin=1.0)
    statuses, _, _, corrections = run(corrector, t[: end + 300], samples[: end + 300])
    flag = Status.NOT_FINITE if fault == "nan" else Status.TIME_JUMP
    assert statuses[half] & flag or (fault == "ahead" and not calibration.looks_back)
    assert (statuses[end + 5 :] == Status.OK).mean() > 0.5
    rest = recording.rows(np.arange(end, end + 300))
    used = np.isfinite(corrections[end:])
    assert used.all()
    # Stamps moved by some seconds are rounded otherwise.
    np.testing.assert_allclose(
        corrections[end:], calibration.predict_error(rest), rtol=0, atol=1e-9
    )


def test_it_loads_without_the_training_stack(tmp_path):
    lines, expected = [], []
    for name in {family.name: name for name, family in FAMILIES.items()}.values():
        path = tmp_path / name
        calibration, _, (row, _) = unseen_samples(name, 2)
        write_calibration(calibration, path)
        own = ready(calibration)
        own.step(0.0, row)
        expected.append(own.correction[0])
        lines.append(
            f"c = Corrector({str(path)!r}); c.set_homing(True); c.step(0.0, {row.tolist()!r}); "
            "print(c.correction[0])"
        )
    code = "import sys; from truejoint.runtime import Corrector\n" + "\n".join(lines)
    code += f"\nprint([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run(  # noqa: S603 - lines of our own
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    *corrections, heavy = done.stdout.split("\n")[:-1]
    assert heavy == "[]"
    assert np.isfinite(expected).all()
    assert [float(one) for one in corrections] == expected


@pytest.mark.parametrize("name", [n for n in CAUSAL if FAMILIES[n].counts_samples])
def test_called_faster_or_slower_than_trained_it_says_so_and_starts_anew(name):
    calibration, recording, samples = unseen_samples(name, 400)
    step = float(np.median(np.diff(recording.t)))
    slow, end = slice(100, 140), 140
    t = np.array(recording.t)
    t[slow] += step * np.arange(1, 41)
    t[end:] += 40 * step
    fast = recording.t[0] + (recording.t - recording.t[0])[:200] / 5.0
    stale = run(ready(calibration), fast, samples)[0] & Status.STALE > 0
    assert stale.mean() > 0.7
    statuses, _, _, corrections = run(ready(calibration, range_margin=1.0), t, samples)
    flagged = statuses & Status.TIME_JUMP > 0
    assert not flagged[:115].any()
    assert flagged[122:end].all()
    assert not flagged[end + 20 :].any()
    assert (statuses[end + 20 :] == Status.OK).mean() > 0.5
    with pytest.raises(CalibrationError, match="resample it, or calibrate at this rate"):
        calibration.correct(restamped(recording.rows(slow), t[slow]))
    rest = restamped(recording.rows(np.arange(end - 1, 400)), t[end - 1 :])  # the last late one
    assert np.isfinite(corrections[end - 1 :]).all()
    np.testing.assert_allclose(
        corrections[end - 1 :], calibration.predict_error(rest), rtol=0, atol=1e-12
    )


@pytest.mark.parametrize("level", [0.9, 0.5])
def test_half_width_is_the_filters_own(level):
    """That of other filters is looked at in tests/estimators."""
    calibration, recording, samples = unseen_samples("ukf_elastic")
    statuses, _, widths, _ = run(ready(calibration, level=level), recording.t[:800], samples[:800])
    good = statuses == Status.OK
    assert good.sum() > 100
    X = calibration.feature_set.compute(recording, calibration.gap_limit)
    dt = time_steps(np.array(recording.t), calibration.gap_limit)
    deviation = estimate(calibration.model, X, dt).angle_deviation[:800, 0]
    expected = NormalDist().inv_cdf(0.5 + 0.5 * level) * deviation
    np.testing.assert_allclose(widths[good, 0], expected[good], rtol=1e-9)


def test_the_stated_width_holds():
    """The jaw's filter with friction in its state, on a motion that it was not fitted to."""
    calibration, recording = model("ukf_friction"), forceps()[1]
    samples = recording.table[list(calibration.loop_signals)].to_numpy()
    statuses, positions, widths, _ = run(ready(calibration), recording.t, samples)
    good = (statuses == Status.OK) & (recording.t > 2.2)
    inside = np.abs(positions[:, 0] - recording.column("truth/jaw"))[good] <= widths[good, 0]
    assert 0.8 < inside.mean() < 0.97


@pytest.mark.parametrize("name", WITH_WIDTH)
@pytest.mark.parametrize("rezero", [0.0, 10.0])
def test_an_interval_comes_before_the_filters_own_width(name, rezero):
    calibration, recording, samples = unseen_samples(name, 50)
    widths = np.full((1, len(calibration.joints)), 0.003)
    interval = Interval(np.array([0.9]), widths, 2.0, rezero, 12, 12)
    loop = ready(replace(calibration, interval=interval))
    statuses, _, found, _ = run(loop, recording.t, samples)
    good = statuses == Status.OK
    assert good.sum() > 10
    if rezero:
        assert np.isinf(found).all()
        zeroed = replace(calibration, interval=interval, zero=Zero(np.zeros(len(widths[0]))))
        widths = run(ready(zeroed), recording.t, samples)[2]
        assert np.isfinite(widths[good]).all()  # a file that is re-zeroed has it at once
    else:
        assert (found[good] >= 0.003).all()
        assert (found[good] < 0.01).all()


@pytest.mark.parametrize("level", [0.0, 1.0, -1.0, np.nan])
def test_an_impossible_level_is_refused(level):
    with pytest.raises(CalibrationError, match="level"):
        Corrector(model("ukf_friction"), level=level)


@given(st.data(), st.sampled_from(CAUSAL))
@settings(max_examples=80)
def test_mutated_model_files_are_refused_in_one_line(tmp_path, data, name):
    """Also those with a sound hash: someone may sign whatever they like."""
    description, arrays = encode(model(name))
    description = copy.deepcopy(description)
    odd = st.sampled_from(
        [None, -1, 0, "", "x" * 50, [], {}, True, 1e300, 1e-300, ["a"], {"a": 1}, [1e-5], 3]
    )
    what = data.draw(st.sampled_from(["description", "params", "numbers", "shape"]))
    table = description["fit"]["model"]["params"] if what == "params" else description
    if what in ("description", "params") and table:
        table[data.draw(st.sampled_from(sorted(table)))] = data.draw(odd)
    else:
        some = sorted(arrays if data.draw(st.booleans()) else fnmatch.filter(arrays, "model/*"))
        which = data.draw(st.sampled_from(some))
        number = data.draw(st.sampled_from([np.nan, np.inf, -1e300, 1e300, 0.0, -1.0]))
        shape = data.draw(st.sampled_from([(0,), (1,), (3,), (4, 4), (1, 2)]))
        full = np.full_like(arrays[which], number)
        arrays[which] = full if what == "numbers" else np.zeros(shape)
    path = tmp_path / "model.safetensors"
    path.write_bytes(to_bytes(description, arrays))
    try:
        corrector = ready(path)
    except ModelFileError as error:
        assert path.name in str(error)  # noqa: PT017  # other exceptions must pass through
        assert "\n" not in str(error)  # noqa: PT017
        return
    recording = unseen(name)
    samples = recording.table[list(corrector.signals)].to_numpy()
    for i in range(3):
        corrector.step(recording.t[i], samples[i])
        assert np.isfinite(corrector.position).all()
