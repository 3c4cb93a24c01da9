"""The way of a dVRK's arm by command, on its twin: record, calibrate, touch, re-zero, simulate."""

from __future__ import annotations

import ctypes
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from tests.export.library import COMPILER, FLAGS, PLAIN, needs_compiler

import truejoint
from truejoint.estimators.registry import ERROR_MODELS

ARM = "dvrk_psm:psm1"
REZEROED = ("outer_yaw", "outer_pitch", "outer_insertion")


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Two recordings of one homing, and one of the next power-on, of seed 8."""
    folder = tmp_path_factory.mktemp("psm")
    for seed, lengths in ((0, {"learn": 90.0, "test": 45.0}), (8, {"seed8": 20.0})):
        with truejoint.crtk.simulated_arm("dvrk_psm", "psm1", seed=seed) as arm:
            arm.enable()
            arm.home()
            for name, length in lengths.items():
                motion = truejoint.motion.random_motion(arm.robot, length, seed=len(name))
                with truejoint.recordings.Recorder(arm, path=folder / f"{name}.parquet"):
                    truejoint.motion.follow(arm, motion)
    return folder


def without(columns, recording, path):
    """Write a recording that lacks these columns."""
    units = {name: unit for name, unit in recording.units.items() if name not in columns}
    table = recording.table.drop(columns=columns)
    truejoint.write_parquet(replace(recording, table=table, units=units), path)


@pytest.mark.usefixtures("hasty")
def test_touches_find_the_zero_of_another_power_on(call, session, tmp_path):
    call.good(f"calibrate {session}/learn.parquet -e linear -o psm1.safetensors")
    call.good(f"touch block {ARM} -o .")
    call.good("touch run psm1.safetensors --block block.toml --count 8 -o day_one.csv")
    call.good("touch bolt psm1.safetensors --touches day_one.csv --block block.toml -o pose.toml")
    call.good("touch run psm1.safetensors --bolted pose.toml --seed 8 -o today.csv")
    call.good("rezero psm1.safetensors --touches today.csv --bolted pose.toml -o today.safetensors")
    today = truejoint.read_recording(session / "seed8.parquet")
    errors = []
    for name in ("psm1", "today"):
        model = truejoint.read_calibration(tmp_path / f"{name}.safetensors")
        rest = today.with_truth(model.joints)
        left = model.correct(rest) - rest.columns("truth", model.joints)
        errors.append(np.sqrt((left**2).mean(axis=0))[:3])
    assert (errors[1] < 0.5 * errors[0])[[0, 2]].all()
    assert errors[1][1] < errors[0][1]


def test_potentiometers_find_the_zero_of_another_power_on(call, session, tmp_path):
    model, learn = tmp_path / "psm1.safetensors", session / "learn.parquet"
    before = truejoint.calibrate(truejoint.read_recording(learn), "linear")
    truejoint.write_calibration(before, model)
    today = truejoint.read_recording(session / "seed8.parquet")
    truth = [name for name in today.units if name.startswith("truth")]
    without(truth, today, tmp_path / "bare.parquet")
    done = call.good(f"rezero {model} bare.parquet -o today.safetensors")
    assert "re-zeroed by the potentiometers in bare.parquet" in done.out
    said = call.json(f"rezero {model} {session}/seed8.parquet --potentiometers -o t.safetensors")
    assert said["source"] == "potentiometers"
    after = truejoint.read_calibration("today.safetensors")
    assert after.zero.shift.tolist() == said["shift"]
    run = today.with_truth(before.joints)
    errors = [
        np.sqrt(((m.correct(run) - run.columns("truth", m.joints)) ** 2).mean(axis=0))
        for m in (before, after)
    ]
    assert (errors[1][:3] < [0.4 * errors[0][0], errors[0][1], 0.4 * errors[0][2]]).all()

    # A bag has the potentiometers of three joints; the others keep their zeros.
    call.good(f"export {session}/seed8.parquet --to bag -o today.mcap")
    call.good(f"extract today.mcap --robot {ARM} -o from_bag.parquet")
    done = call.good(f"rezero {model} from_bag.parquet --potentiometers -o t.safetensors --force")
    assert "outer_wrist_yaw: no potentiometer, or hardly moved; the zero stays" in done.out
    shift = truejoint.read_calibration("t.safetensors").zero.shift
    np.testing.assert_allclose(shift[:3], said["shift"][:3], rtol=0, atol=1e-9)
    assert not shift[3:].any()
    call.refuses(
        "--touches",
        f"rezero {model} from_bag.parquet --potentiometers --touches x.csv --bolted y.toml -o x.st",
    )


BRIDGE = """
#include "psm_error_model.h"
void report(int n, const double *t, const double *truth, const double *normal, double *out);
void report(int n, const double *t, const double *truth, const double *normal, double *out)
{
    static psm_error_model model;
    psm_error_model_init(&model);
    for (int i = 0; i < n; i++) {
        psm_report(&model, t[i], truth + 2 * i, normal + 2 * i, out + 2 * i);
    }
}
"""


@needs_compiler
def test_a_simulator_in_c_reports_as_in_python(call, session, tmp_path):
    today = truejoint.read_recording(session / "seed8.parquet")
    without([f"truth/{name}" for name in today.joints_of("truth")[2:]], today, "two.parquet")
    said = call.json("export two.parquet --to simulator --prefix psm -o sim")
    folder = tmp_path / "sim"
    model = truejoint.read_calibration(folder / "psm.safetensors")
    assert model.metadata["noise"] == said["noise"]
    (folder / "bridge.c").write_text(BRIDGE)
    sources = [folder / "bridge.c", folder / "psm.c"]
    made = [COMPILER, *FLAGS, *PLAIN, "-o", folder / "psm.so", *sources, "-lm"]
    subprocess.run(made, check=True)  # noqa: S603 - the compiler
    assert (model.estimator, len(model.joints)) == (ERROR_MODELS[True], 2)
    run = today.with_truth(model.joints).rows(slice(200))
    true = np.ascontiguousarray(run.columns("truth", model.joints))
    stepping = truejoint.runtime.ErrorModel(model, seed=5)
    stamps = run.t.copy()
    stamps[50] = np.nan
    python = np.array([stepping.step(t, row) for t, row in zip(stamps, true, strict=True)])
    normal, out = np.random.default_rng(5).standard_normal(true.shape), np.empty_like(true)
    at = [values.ctypes.data_as(ctypes.c_void_p) for values in (stamps, true, normal, out)]
    ctypes.CDLL(str(folder / "psm.so")).report(len(true), *at)
    np.testing.assert_allclose(out, python, rtol=0, atol=1e-12)


def test_a_simulator_errs_as_much_as_the_arm(session):
    """The twin is the arm: recordings of it judge what is learnt from it."""
    run, test = (truejoint.read_recording(session / f"{n}.parquet") for n in ("learn", "test"))
    model = truejoint.calibration.learn_error_model(run, "rich_play")
    test = test.with_truth(model.joints)
    errors = []
    for noisy in (False, True):
        stepping = truejoint.runtime.ErrorModel(model, seed=2, noisy=noisy)
        true = test.columns("truth", model.joints)
        reported = [stepping.step(t, row) for t, row in zip(test.t, true, strict=True)]
        errors.append(true - np.array(reported))
    real = test.error(model.joints)
    assert errors[1].std(axis=0) == pytest.approx(real.std(axis=0), rel=0.25)
    # Mean and course, not only size: what is left is smaller than a fixed offset leaves.
    left = (errors[0] - real).std(axis=0) / real.std(axis=0)
    assert (left < 0.7).all()
    size = [model.metadata["noise"][joint][0] for joint in model.joints]
    assert (errors[1] - errors[0]).std(axis=0) == pytest.approx(size, rel=0.5)


def test_a_correction_is_no_error_model(call, session):
    model = truejoint.calibrate(
        truejoint.read_recording(session / "seed8.parquet"), "offset", joints=REZEROED
    )
    with pytest.raises(truejoint.errors.CalibrationError, match="is no error model; make one with"):
        truejoint.runtime.ErrorModel(model)
    said = "--to simulator takes --prefix"
    call.refuses(said, f"export {session}/seed8.parquet --to simulator --compensate -o sim")
    learnt = truejoint.calibration.learn_error_model(
        truejoint.read_recording(session / "seed8.parquet"), "linear"
    )
    with pytest.raises(truejoint.errors.CalibrationError, match="want one for each of outer_yaw"):
        truejoint.runtime.ErrorModel(learnt).step(0.0, np.zeros(5))
