"""Re-zeroing: only the offset moves, and it says how well it is known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.runtime.registered import fit, good_rows, model, ready, training, unseen

from truejoint.calibration import (
    Calibration,
    calibrate,
    find_zero,
    read_calibration,
    write_calibration,
)
from truejoint.calibration.conformal import knowing_errors
from truejoint.calibration.efforts import BEGINNINGS, time_in_motion
from truejoint.calibration.rows import shift_signals
from truejoint.calibration.truth_zero import CORRELATION_MARGIN, judged_error
from truejoint.errors import CalibrationError, ModelFileError
from truejoint.estimators import NeuralNetwork
from truejoint.estimators.family import evaluate
from truejoint.recordings import Recording

FEATURES = ("measured/shoulder", "measured/elbow", "measured/insertion", "effort/elbow")


def homed_again(recording: Recording, offset: np.ndarray, known: slice) -> Recording:
    """The same motion after a homing that shifted it, with little truth."""
    changed = {}
    for k, joint in enumerate(recording.robot.positioning):
        truth = np.full(len(recording), np.nan)
        truth[known] = recording.column(f"truth/{joint}")[known] + offset[k]
        changed[f"truth/{joint}"] = truth
    about = replace(recording.provenance, homing_id="h2", source="brief")
    return Recording(recording.table.assign(**changed), recording.units, about)


SMALL = NeuralNetwork(hidden_layer_sizes=(8,), epochs=3)


@pytest.fixture(scope="module")
def linear(recording) -> Calibration:
    return calibrate(recording, "linear", features=FEATURES)


@pytest.fixture(scope="module")
def remembering(recording) -> Calibration:
    return calibrate(recording, "rich_play", features=FEATURES)


def test_rows_are_predicted_once_for_every_zero_of_a_fit(build, linear, monkeypatch):
    recording, calls = build(300, 4), []
    other = replace(
        calibrate(build(300, 5), "linear", features=FEATURES), gap_limit=linear.gap_limit
    )
    fresh = [each.shifted(np.full(3, 0.1)).correct(recording) for each in (linear, other)]

    def counted(*args):
        calls.append(args)
        return evaluate(*args)

    monkeypatch.setattr("truejoint.calibration.calibration.evaluate", counted)
    rows = linear.rows(recording)
    for each, expected in zip((linear, other), fresh, strict=True):
        judged_error(each, rows, 1.0)
        assert each.shifted(np.full(3, 0.1)).correct(rows).tobytes() == expected.tobytes()
    assert len(calls) == 2


@pytest.mark.parametrize("estimator", ["linear", SMALL], ids=str)
def test_an_estimator_of_several_joints_moves_by_the_offset_and_nothing_else(
    build, recording, estimator, tmp_path
):
    calibration = calibrate(recording, estimator, features=FEATURES)
    test = build(300, 4)
    brief = homed_again(test, np.array([0.01, -0.02, 0.003]), slice(100, 140))
    moved = calibration.at(find_zero(calibration, brief))
    zero = find_zero(calibration, brief)
    error = brief.columns("truth", moved.joints)[100:140] - calibration.correct(brief)[100:140]
    assert zero.offset == pytest.approx(np.median(error, axis=0), abs=1e-15)
    assert moved.correct(test) - calibration.correct(test) == pytest.approx(
        np.broadcast_to(zero.shift, (300, 3)), abs=1e-12
    )
    assert (np.abs(zero.shift) <= np.abs(zero.offset)).all()
    left = find_zero(moved, brief)
    assert left.offset == pytest.approx(zero.offset - zero.shift, abs=1e-12)
    assert left.shift == pytest.approx(np.zeros(3))
    assert find_zero(moved.baselines["offset"], brief).offset == pytest.approx(0, abs=1e-12)
    assert moved.origin.homing_ids == ("h2",)
    assert moved.zero.rows == 40
    write_calibration(moved, tmp_path / "m.safetensors")
    again = read_calibration(tmp_path / "m.safetensors")
    assert again.correct(test).tobytes() == moved.correct(test).tobytes()


def test_a_few_wrong_readings_do_not_move_the_zero(build, linear):
    brief = homed_again(build(300, 4), np.zeros(3), slice(0, 100))
    table = brief.table.copy()
    table.loc[::10, [f"truth/{j}" for j in linear.joints]] += 1.0
    wrong = Recording(table, brief.units, brief.provenance)
    shift = find_zero(linear, wrong).offset - find_zero(linear, brief).offset
    assert np.abs(shift).max() < 2e-3  # their mean moves by 0.1: a tenth is 1 rad off


def test_uncertainty_is_that_of_the_mean_of_correlated_errors(build, linear):
    known = linear.effort_baseline
    none = replace(known, beginning=np.full_like(known.beginning, 1e-12))
    linear = replace(linear, effort_baseline=none)
    brief = homed_again(build(300, 4), np.zeros(3), slice(0, 60))
    zero = find_zero(linear, brief)
    rng = np.random.default_rng(0)
    measured = brief.columns("measured", linear.joints)[:60]
    in_motion = time_in_motion(np.array(brief.t[:60]), measured, known.step)
    for k in range(3):
        size = linear.effort_baseline.residual[k]
        time = CORRELATION_MARGIN * linear.effort_baseline.correlation[k]
        t = in_motion[:, k]
        covariance = size**2 * np.exp(-np.abs(t[:, None] - t) / time)
        means = rng.multivariate_normal(np.zeros(60), covariance, 4000).mean(axis=1)
        assert zero.deviation[k] == pytest.approx(means.std(), rel=0.06)
    one = homed_again(build(300, 4), np.zeros(3), slice(7, 8))
    assert find_zero(linear, one).deviation == pytest.approx(linear.effort_baseline.residual)
    bare = replace(linear, effort_baseline=None)
    assert np.isnan(find_zero(bare, one).deviation).all()
    assert np.isnan(bare.at(find_zero(bare, one)).zero.deviation).all()


@pytest.mark.parametrize("made", ["linear", "remembering"])
def test_a_rest_tells_as_much_as_one_reading(build, made, request):
    """Held where it begins, truth and all, for however long."""
    calibration = request.getfixturevalue(made)
    known, recording = calibration.effort_baseline, build(300, 4)
    found = []
    for held in (1, 30, 600):
        rows = np.concatenate([np.zeros(held, dtype=np.int64), np.arange(1, 300)])
        table = recording.table.iloc[rows].reset_index(drop=True)
        table = table.assign(t=np.arange(len(rows)) / 30.0)
        for duration in (held / 30.0, held / 30.0 + 3.0):
            found.append(find_zero(calibration, replace(recording, table=table), duration))
    sd = np.maximum(known.residual, known.beginning[0])
    for rest, motion in zip(found[::2], found[1::2], strict=True):
        assert rest.deviation == pytest.approx(sd, rel=1e-9)
        assert rest.offset == pytest.approx(found[0].offset, abs=0.1 * known.residual.min())
        assert (motion.deviation < sd).any()


def test_a_model_that_errs_nowhere_is_kept_in_a_file_too(recording, linear, tmp_path):
    model = linear
    columns = {f"truth/{j}": model.correct(recording)[:, k] for k, j in enumerate(model.joints)}
    right = replace(recording, table=recording.table.assign(**columns))
    path = tmp_path / "m.safetensors"
    write_calibration(knowing_errors(model, [(model, [right])]), path)
    known = read_calibration(path).effort_baseline
    assert (known.residual < 1e-12).all()
    assert (known.beginning < 1e-12).all()


def test_an_offset_of_a_beginning_is_as_sure_as_beginnings_of_the_training_are(build, linear):
    known = linear.effort_baseline
    spread = 0.5 / np.sqrt(BEGINNINGS)[:, None] * np.ones(3)
    wide = replace(known, beginning=spread)
    for duration, worth in ((2.0, 2.0), (5.0, 5.0), (80.0, 80.0), (0.0, BEGINNINGS[0])):
        times = np.full(3, duration)
        assert wide.beginning_sd(times) == pytest.approx(0.5 / np.sqrt(worth) * np.ones(3))
    zero = find_zero(replace(linear, effort_baseline=wide), build(300, 4), 2.0)
    assert zero.deviation == pytest.approx(0.5 / np.sqrt(2.0) * np.ones(3), rel=0.03)
    assert zero.shift.tolist() == [0.0, 0.0, 0.0]
    plain = find_zero(linear, build(300, 4), 2.0)
    assert (plain.deviation < 0.1 * zero.deviation).all()
    np.testing.assert_array_equal(plain.offset, zero.offset)


@pytest.fixture(scope="module")
def pair(build):
    """Two recordings whose features cover the same, and the same with zeros of their own."""
    plain = [build(1500, seed, homing_id=f"h{seed}") for seed in (0, 1)]
    zeros = np.array([[0.03, -0.02, 0.004], [-0.01, 0.05, -0.003]])
    truths = [f"truth/{joint}" for joint in plain[0].robot.positioning]
    pairs = zip(plain, zeros, strict=True)
    return plain, [shift_signals(recording, truths, zero) for recording, zero in pairs], zeros


@pytest.fixture(scope="module")
def zeroed(pair) -> list[Calibration]:
    """Linear models of the pair, with a zero for each recording."""
    return [calibrate(ones, "linear", features=FEATURES, zero="recording") for ones in pair[:2]]


def test_all_of_an_offset_is_believed_where_zeros_are_known_to_move(pair, linear, zeroed):
    for fitted, all_of_it in ((linear, False), (zeroed[1].for_rezeroing, True)):
        zero = find_zero(fitted, pair[0][0].rows(slice(0, 30)))
        assert (zero.shift.tolist() == zero.offset.tolist()) is all_of_it


def test_readings_weigh_by_the_past_before_them_where_the_model_looks_back(build, remembering):
    calibration, recording = remembering, build(300, 4)
    error = recording.columns("truth", calibration.joints) - calibration.correct(recording)
    measured = recording.columns("measured", calibration.joints)
    step = calibration.effort_baseline.step
    past = np.clip(time_in_motion(np.array(recording.t), measured, step), 1e-3, 5.0)
    for k, offset in enumerate(find_zero(calibration, recording).offset):
        order = np.argsort(error[:, k])
        reached = np.cumsum(past[order, k])
        assert offset == error[order, k][np.searchsorted(reached, 0.5 * reached[-1])]


def test_without_truth_it_is_refused(recording, linear):
    with pytest.raises(CalibrationError, match="brief: no row has the truth of shoulder, elbow"):
        linear.at(find_zero(linear, homed_again(recording, np.zeros(3), slice(0, 0))))
    bare = recording.table.drop(columns=["truth/elbow"])
    with pytest.raises(CalibrationError, match="synthetic-0 has no truth of elbow"):
        find_zero(linear, Recording(bare, recording.units, recording.provenance))


START = 2.0  # [s] of truth that re-zeroes


def homed_apart(recordings: Sequence[Recording]) -> list[Recording]:
    """Several recordings, or the only one in two, as if the robot had been homed before each."""
    found = list(recordings)
    if len(found) == 1:
        found = [found[0].rows(slice(0, len(found[0]) // 2)),
                 found[0].rows(slice(len(found[0]) // 2, None))]  # fmt: skip
    names = (replace(one.provenance, homing_id=f"h{i}") for i, one in enumerate(found))
    return [replace(one, provenance=name) for one, name in zip(found, names, strict=True)]


def off(recording: Recording, joints: Sequence[str], by: np.ndarray) -> Recording:
    """The recording with the zero of its truth off."""
    return shift_signals(recording, tuple(f"truth/{joint}" for joint in joints), by)


def rmse(calibration: Calibration, recording: Recording, rezero: float = START) -> np.ndarray:
    return np.sqrt(np.mean(judged_error(calibration, recording, rezero)[0] ** 2, axis=0))


@pytest.mark.parametrize(
    "name",
    ["linear", "dnn", "linear_trees", "rich_play", "gru", "ukf", "ukf_friction", "ukf_elastic"],
)
def test_moved_zeros_spoil_no_way_of_learning_that_is_re_zeroed(name, tmp_path):
    """To single values, to whole rows, to all rows with a history; by plays and by filters."""
    known = model(name)
    random = np.random.default_rng(3)
    brief = training(name)[:3]
    if name == "ukf_elastic":  # its recordings have many more rows than it takes
        brief = [one.rows(slice(0, 800)) for one in brief]
    moved = [
        off(recording, known.joints, 0.03 * random.choice([-1.0, 1.0], len(known.joints)))
        for recording in homed_apart(brief)
    ]
    fitted = fit(name, moved, zero="recording")
    other = unseen(name).rows(np.arange(1500))
    test = off(other, known.joints, np.full(len(known.joints), 0.05))
    within = 2.0 * rmse(known, other) + 1e-3
    assert (rmse(fitted.for_rezeroing, test) < within).all()
    path = tmp_path / "model.safetensors"
    write_calibration(fitted, path)
    read = read_calibration(path)
    again = read.at(find_zero(read, test, START))
    whole = fitted.at(find_zero(fitted, test, START)).correct(test)
    np.testing.assert_array_equal(again.correct(test), whole)
    assert good_rows(again, test, whole, 100) == 100


def test_the_second_fit_does_not_know_the_zeros(pair, zeroed, build):
    _, _, zeros = pair
    (first, second), test = zeroed, build(300, 4)
    pairs = [(m.for_rezeroing.correct(test)) for m in (first, second)]
    average = zeros.mean(axis=0)  # of the zeros that were put in, which the second fit keeps
    np.testing.assert_allclose(pairs[1] - pairs[0] - average, 0.0, rtol=0, atol=1e-9)
    found, own = (m.origin.zeros for m in (second, first))
    np.testing.assert_allclose(found - own, zeros - average, rtol=0, atol=1e-12)
    assert (rmse(second, test, 0.0) > 2.0 * rmse(first, test, 0.0)).any()  # the plain one does


def test_without_re_zeroing_it_is_the_plain_fit(pair, build):
    plain, _, _ = pair
    test = build(300, 4)
    shared = calibrate(plain, SMALL, features=FEATURES)
    both = calibrate(plain, SMALL, features=FEATURES, zero="recording")
    assert both.correct(test).tobytes() == shared.correct(test).tobytes()
    assert set(both.rezeroed_fit.baselines) == set(both.fitted_baselines)
    assert shared.for_rezeroing is shared
    assert shared.origin.zeros is None


def test_what_has_no_zeros_of_its_own_is_refused(build):
    with pytest.raises(CalibrationError, match="takes two recordings; give more"):
        calibrate(build(600, 0), "linear", features=FEATURES, zero="recording")
    with pytest.raises(CalibrationError, match="choose shared, recording"):
        calibrate(build(600, 0), "linear", features=FEATURES, zero="session")


def test_the_loop_runs_the_fit_for_motions_that_begin_with_a_zero(zeroed, build):
    model, test = zeroed[1], build(300, 4)
    for fitted in (model, model.for_rezeroing):
        trace = ready(fitted, range_margin=1.0).run(test.rows(slice(0, 60)))
        np.testing.assert_array_equal(trace.position, fitted.correct(test)[:60])
    assert not np.allclose(model.correct(test), model.for_rezeroing.correct(test))


def test_a_zero_that_is_none_is_refused(zeroed, tmp_path):
    model, _ = zeroed
    for number, wrong in enumerate(
        (
            {"offsets": {"model": np.zeros(2)}},
            {"offsets": {"oracle": np.zeros(3)}},
            {"offsets": {"model": np.full(3, np.nan)}},
            {"moves": np.zeros((2, 3))},
            {"rezeroed_fit": model.rezeroed_fit._replace(baselines={})},
        )
    ):
        path = tmp_path / f"{number}.safetensors"
        write_calibration(replace(model, **wrong), path)
        with pytest.raises(ModelFileError, match=r"zero|re-zeroing") as caught:
            read_calibration(path)
        assert "\n" not in str(caught.value)
