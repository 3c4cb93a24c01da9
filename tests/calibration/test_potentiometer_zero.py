"""A zero by potentiometers: what moved since the training, and how well that is known."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from truejoint import Recording, calibrate, read_calibration, write_calibration
from truejoint.calibration import find_zero, potentiometer_zero
from truejoint.calibration.potentiometers import learn_reference
from truejoint.crtk import simulated_arm
from truejoint.motion import follow, random_motion
from truejoint.recordings import Recorder

JOINTS = ("shoulder", "elbow", "insertion")
FEATURES = tuple(f"measured/{joint}" for joint in JOINTS)
NOISE = 2e-3


def with_pots(recording, moved=(0.0, 0.0, 0.0), *, seed=0, joints=JOINTS, scale=1.02):
    """Encoders `moved` by a power-on; potentiometers of another scale, bent, and noisy."""
    rng, changed = np.random.default_rng(seed), {}
    for joint, by in zip(JOINTS, moved, strict=True):
        position = recording.column(f"measured/{joint}")
        changed[f"measured/{joint}"] = position + by
        if joint in joints:
            bent = scale * position + 0.01 + 3e-3 * np.sin(9.0 * position)
            changed[f"pot/{joint}"] = bent + NOISE * rng.standard_normal(len(position))
    units = {**recording.units, **{f"pot/{j}": recording.units[f"measured/{j}"] for j in joints}}
    return Recording(recording.table.assign(**changed), units, recording.provenance)


@pytest.fixture(scope="module")
def model(build):
    return calibrate(with_pots(build(3000, 1), seed=9), "linear", features=FEATURES, joints=JOINTS)


def test_a_power_on_is_found_within_the_stated_deviation(build, model):
    ratios = []
    for seed in range(20):
        moved = 0.01 * np.random.default_rng(seed).standard_normal(3)
        zero = potentiometer_zero(model, with_pots(build(600, 50 + seed), moved, seed=seed))
        ratios.append((zero.offset + moved) / zero.deviation)
        assert (zero.deviation < NOISE / 10).all()
    rms = np.sqrt(np.square(ratios).mean(axis=0))
    assert (rms < 1.6).all()
    assert (rms > 0.5).all()


def test_power_ons_of_a_psm_are_found():
    """Its preload is what moves, and the tool errs as on the day of the calibration."""
    runs, zeros = [], []
    for seed in range(4):
        with simulated_arm("dvrk_psm", "psm1", seed=seed) as arm:
            arm.enable()
            arm.home()
            twin = arm._backend.twin
            zeros.append((twin._plant.joint_from_motor @ twin.encoder_zero)[:6])
            with Recorder(arm) as recorder:
                follow(arm, random_motion(arm.robot, 60.0 if seed == 0 else 20.0, seed=seed))
            runs.append(recorder.recording().with_truth(arm.robot.positioning))
    model, ratios, gains = calibrate(runs[0], "linear"), [], []
    for run, zero in zip(runs[1:], zeros[1:], strict=True):
        found = potentiometer_zero(model, run)
        ratios.append((found.offset - (zero - zeros[0])) / found.deviation)
        places = [
            [pose[:3, 3] for pose in run.robot.kinematics.forward(np.column_stack([joints, jaw]))]
            for jaw in [run.column("measured/jaw")]
            for joints in (run["truth"], model.correct(run), model.at(found).correct(run))
        ]
        off = np.linalg.norm(np.array(places[1:]) - places[0], axis=2)
        gains.append(np.sqrt((off**2).mean(axis=1)))
    assert 0.6 < np.sqrt(np.square(ratios).mean()) < 1.6
    before, after = np.array(gains).T
    assert (after < np.minimum(before, 2.5e-4)).all()
    assert np.sqrt((after**2).mean() / (before**2).mean()) < 0.4


def test_a_zero_that_hardly_moved_is_left(build, model):
    zero = potentiometer_zero(model, with_pots(build(600, 60), seed=3))
    assert (np.abs(zero.shift) <= np.abs(zero.offset)).all()
    assert np.count_nonzero(zero.shift) < 3
    far = potentiometer_zero(model, with_pots(build(600, 60), (0.02, 0.0, 0.0), seed=3))
    assert far.shift[0] == pytest.approx(-0.02, abs=5 * far.deviation[0])
    assert (far.source, far.homing_id) == ("potentiometers", "h1")
    # It is the zero of the encoders, which a whole truth tells too.
    again = find_zero(model, with_pots(build(600, 60), (0.02, 0.0, 0.0)))
    assert model.at(far).offset[0] == pytest.approx(again.offset[0], abs=2e-3)


def test_a_joint_that_rests_keeps_its_zero(build, model):
    whole = with_pots(build(600, 61), (0.01, 0.01, 0.01))
    still = {name: np.full(600, 0.5) for name in ("measured/elbow", "pot/elbow")}
    zero = potentiometer_zero(model, replace(whole, table=whole.table.assign(**still)))
    assert np.isnan(zero.deviation).tolist() == [False, True, False]
    assert zero.shift[1] == 0.0
    assert zero.shift[0] == pytest.approx(-0.01, abs=1e-3)
    still = whole.rows(slice(0, 3))
    refused("shoulder, elbow, insertion hardly moved", potentiometer_zero, model, still)


def test_a_reference_is_of_joints_that_every_recording_has(build, tmp_path):
    pots = with_pots(build(600, 2)), with_pots(build(600, 3), joints=("elbow",))
    reference = learn_reference(pots, JOINTS)
    assert reference.rows.any(axis=1).tolist() == [False, True, False]
    assert learn_reference([build(600, 2)], JOINTS) is None
    model = calibrate(pots, "linear", features=FEATURES, joints=JOINTS)
    write_calibration(model, tmp_path / "m.safetensors")
    read = read_calibration(tmp_path / "m.safetensors").potentiometers
    for name, values in vars(model.potentiometers).items():
        np.testing.assert_array_equal(getattr(read, name), values)
    zero = potentiometer_zero(model, with_pots(build(600, 4), (0.0, 0.01, 0.0)))
    assert np.isnan(zero.deviation).tolist() == [True, False, True]
    in_counts = replace(pots[0], units={**pots[0].units, "pot/elbow": "1"})
    refused("'pot/elbow' is in 1, not in rad", learn_reference, [in_counts], JOINTS)


def test_a_joint_that_never_moved_in_the_training_tells_no_zero(build):
    still = with_pots(build(600, 1))
    table = still.table.assign(**{"measured/elbow": 0.5})
    known = learn_reference([Recording(table, still.units, still.provenance)], JOINTS)
    assert np.count_nonzero(known.rows, axis=1).tolist() == [24, 1, 24]


def test_what_tells_no_zero_is_one_line(build, model):
    run, today = build(600, 5), with_pots(build(600, 5), (0.01, 0.0, 0.0))
    bare = calibrate(run, "linear", features=FEATURES)
    moved = model.at(potentiometer_zero(model, today))
    for given, recording, said in (
        (model, run, "lacks pot/shoulder, pot/elbow, pot/insertion, which the reference"),
        (model, with_pots(run, scale=1.06), "shoulder disagrees with its reference"),
        (bare, today, "keeps no reference of potentiometers"),
        (moved, today, "it was re-zeroed before"),
    ):
        refused(said, potentiometer_zero, given, recording)
