"""Re-zeroing and calibrating by touching a block, on arms that nobody has seen.

    python -m benchmarks.touch [--nothing] [--twins nominal peng2024] [--arms 10] [--hours 3]

An arm is a specimen of the RAVEN-II twin whose physics are drawn anew: scale, coupling, friction
and stiffness by up to 20 %, zeros by .3 to .5 deg or mm, run-out by any phase. On the first day it
is homed, recorded along zig-zags with joint encoders (13 min), and touches thirty dimples, which
give the block's pose. After a new homing, and again after `--hours` of random motion, six touches,
planned, re-zero the models. What is judged is five minutes of random motion, by the joint positions
that only the twin knows. A touch has .2 mm of noise per axis.

With `--nothing` there is no first day: thirty planned touches calibrate joints and block together.
Judged is the tip in the block's frame, its pose as estimated; again with two touches 1 mm off in
each axis, with two numbers exchanged, and with a print .5 % small.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint import Calibration, Recording, calibrate
from truejoint.array_types import Array, Mask
from truejoint.calibration import (
    BlockPose,
    Plate,
    Touches,
    calibrate_by_touch,
    find_block,
    rezeroed_by_touch,
)
from truejoint.calibration.tip_rows import TipPrior, TipRows, TipState
from truejoint.calibration.touch_calibration import Terms
from truejoint.calibration.touch_plan import approach_sides, choose_touches, shortest_order
from truejoint.calibration.touches import known_kinematics, tip_rows, zero_prior
from truejoint.crtk import Arm, SimulatedBackend, StateBlock, TruthBlock
from truejoint.errors import CalibrationError
from truejoint.motion import follow, random_motion, workspace_of, zigzag
from truejoint.motion.touching import SimulatedHand
from truejoint.recordings import Recorder
from truejoint.robots.reach import reach
from truejoint.simulation import TwinOutput
from truejoint.simulation.raven2.parameters import Raven2Parameters
from truejoint.simulation.raven2.twin import Raven2Twin

Row = dict[str, Any]
FEW = 6  # touches that re-zero
DISPLAY = np.array([180 / np.pi, 180 / np.pi, 1e3])
TURN = np.array([0.3, -0.2, 0.5])  # of the block in the base [rad]


class Truth:
    """Where the positioning joints of a twin really are, at every state message."""

    def __init__(self) -> None:
        self.t: list[Array] = []
        self.joint: list[Array] = []

    def __call__(self, block: StateBlock | TruthBlock) -> None:
        """Keep a block's rows."""
        if isinstance(block, TwinOutput):
            self.t.append(block.t)
            self.joint.append(block.joint)


def perturbed(specimen: str, seed: int) -> Raven2Parameters:
    """Physics of an arm of its own, of the kind of a specimen."""
    base, rng = Raven2Parameters.read(specimen), np.random.default_rng([seed, 41])

    def by(values: Any, share: float = 0.2) -> Any:
        sizes = np.asarray(values) * (1.0 + rng.uniform(-share, share, np.shape(values)))
        return tuple(sizes.tolist()) if np.ndim(values) else float(sizes)

    pulleys, homing = base.pulleys, base.homing
    phases = rng.uniform(-np.pi, np.pi, (2, 3))
    zero = np.deg2rad([0.3, 0.5, 0.0]) * rng.standard_normal(3)
    zero[2] = 4e-4 * rng.standard_normal()
    return base.with_values(
        {
            "pulleys.scale": by(pulleys.scale),
            "pulleys.coupling_shoulder_elbow": by(pulleys.coupling_shoulder_elbow),
            "pulleys.coupling_shoulder_insertion": by(pulleys.coupling_shoulder_insertion),
            "pulleys.coupling_elbow_insertion": by(pulleys.coupling_elbow_insertion),
            "pulleys.capstan_phase": tuple(phases[0].tolist()),
            "pulleys.joint_phase": tuple(phases[1].tolist()),
            "motor_friction.coulomb": by(base.motor_friction.coulomb),
            "joint_friction.coulomb": by(base.joint_friction.coulomb),
            "cable.stiffness": by(base.cable.stiffness),
            "homing.registration_bias": tuple((np.array(homing.registration_bias) + zero).tolist()),
        }
    )


def new_arm(specimen: str, seed: int) -> Arm:
    """Arm of a perturbed specimen, homed."""
    arm = Arm(SimulatedBackend(Raven2Twin(perturbed(specimen, seed), seed=seed)))
    arm.enable()
    arm.home()
    return arm


def free_points(arm: Arm, count: int, seed: int) -> tuple[Plate, Array, Array]:
    """Dimples anywhere in the workspace, and the pose of their frame."""
    robot, rng = arm.robot, np.random.default_rng([seed, 43])
    space = workspace_of(robot)
    joint = np.tile(robot.home, (count, 1))
    joint[:, :3] = space.centre + 0.96 * space.extent * rng.uniform(-0.5, 0.5, (count, 3))
    chain: Any = robot.kinematics
    tip = chain.forward(joint)[:, :3, 3]
    rotation, translation = Rotation.from_rotvec(TURN).as_matrix(), tip.mean(axis=0)
    points = (tip - translation) @ rotation
    return (
        Plate("free", "raven2", {str(k): p for k, p in enumerate(points)}, 0.08, 0.08),
        rotation,
        translation,
    )


def touched(
    arm: Arm, plate: Plate, pose: tuple[Array, Array], dimples: list[str], seed: int,
    sides: Array | None = None,
) -> tuple[Recording, Touches]:  # fmt: skip
    """Record an arm that touches dimples, each from a random side unless `sides` say it."""
    if sides is None:
        sides = np.random.default_rng([seed, 47]).choice([-1.0, 1.0], (len(dimples), 3))
    with Recorder(arm, session="touches") as recorder:
        hand = SimulatedHand(arm, *pose, seed=seed)
        pairs = zip(dimples, sides, strict=True)
        stamps = [hand.touch(plate.points[n], side) for n, side in pairs]
        hand.close()
    recording = recorder.recording()
    start = recording.provenance.start
    return recording, Touches(tuple(t - start for t in stamps), tuple(dimples))


def observed(arm: Arm, seed: int) -> tuple[Recording, Array, Array, Mask]:
    """Record five minutes of random motion: measured and true positions, and which rows count."""
    motion, truth = random_motion(arm.robot, 300.0, 700 + seed, profile="laboratory"), Truth()
    with Recorder(arm, session="judge") as recorder:
        arm.subscribe(truth)
        follow(arm, motion)
        arm.unsubscribe(truth)
    recording = recorder.recording()
    t, rows = np.concatenate(truth.t), np.concatenate(truth.joint)
    stamps = np.array(recording.t) + recording.provenance.start
    measured = recording.columns("measured", arm.robot.joint_names)
    true = measured.copy()
    true[:, :3] = np.column_stack([np.interp(stamps, t, rows[:, k]) for k in range(3)])
    return recording, measured, true, (stamps >= t[0]) & (stamps <= t[-1])


def judged(arm: Arm, models: dict[str, Calibration], seed: int) -> dict[str, Row]:
    """RMS error [m] of the tip and (3,) of the joints of each model, on random motion."""
    recording, measured, true, inside = observed(arm, seed)
    chain: Any = arm.robot.kinematics
    found = {}
    for name, model in models.items():
        joint = measured.copy()
        joint[:, :3] = model.correct(recording)
        off = chain.forward(joint)[:, :3, 3] - chain.forward(true)[:, :3, 3]
        found[name] = {
            "tip": float(np.sqrt((off[inside] ** 2).sum(axis=1).mean())),
            "joints": np.sqrt(((joint - true)[inside, :3] ** 2).mean(axis=0)).tolist(),
        }
    return found


def models_of(training: list[Recording], names: list[str]) -> dict[str, Calibration]:
    """Calibrations of the first day, by estimator."""
    return {name: calibrate(training, name, random_state=0) for name in names}


def planned(model: Calibration, day: tuple[Recording, Touches], block: BlockPose) -> list[str]:
    """Six of the dimples touched on the first day that tell most of the zeros."""
    rows = tip_rows(model, *day, block.plate)
    homing = np.array([*np.deg2rad([1.0, 1.0]), 1e-3])
    chosen = choose_touches(rows, zero_prior(block, homing), FEW)
    return [day[1].dimple[k] for k in chosen]


def session(specimen: str, seed: int, hours: float, names: list[str]) -> dict[str, Any]:
    """One arm's rows, by estimator and time."""
    arm = new_arm(specimen, seed)
    training = []
    for direction in ("J1", "J2-J3", "J1-J2-J3"):
        with Recorder(arm, session=direction) as recorder:
            follow(arm, zigzag(arm.robot, direction, 1 / 4))
        training.append(recorder.recording())
    models = models_of(training, names)
    plate, *pose = free_points(arm, 30, seed)
    first = touched(arm, plate, (pose[0], pose[1]), list(plate.points), seed)
    blocks = {name: find_block(model, *first, plate)[0] for name, model in models.items()}
    rows = {f"{name} full": row for name, row in judged(arm, models, seed).items()}
    few = planned(models[names[0]], first, blocks[names[0]])
    for when in ("homing", *(["work"] if hours else [])):
        if when == "homing":
            arm.home()
        else:
            way = random_motion(arm.robot, hours * 3600.0, 900 + seed, profile="laboratory")
            follow(arm, way)
        today = touched(arm, plate, (pose[0], pose[1]), few, 1000 + seed)
        again = {}
        for name, model in models.items():
            begin = time.perf_counter()
            try:
                fresh, found = rezeroed_by_touch(model, *today, blocks[name])
            except CalibrationError as error:  # whoever touches is asked to touch again
                print(f"{specimen} {seed}, {name}: {error}")
                continue
            again[f"{name} {when} touched"] = fresh
            rows[f"{name} {when} fit"] = {
                "seconds": time.perf_counter() - begin, "misfit": found.misfit / found.freedom,
                "left_out": int(found.left_out.sum()), "sd": found.sd[:3].tolist(),
            }  # fmt: skip
        old = {f"{name} {when} old": model for name, model in models.items()}
        rows |= judged(arm, old | again, seed + (when == "work"))
    return rows


def planned_points(arm: Arm, seed: int) -> tuple[Plate, tuple[Array, Array], list[str], Array]:
    """Thirty of 120 free dimples that tell most, in a short order, their pose and the sides."""
    plate, *pose = free_points(arm, 120, seed)
    terms, robot = Terms.of(arm.robot), arm.robot
    names = tuple(plate.points)
    goal = plate.at(names) @ pose[0].T + pose[1]
    joint, _ = reach(robot, goal, robot.home)
    own = joint[:, :3]
    features = np.hstack([own, np.repeat(own, 3, axis=1)])  # no play has been gone through yet
    rows = TipRows(
        known_kinematics(robot), joint, (0, 1, 2), terms.basis(features), plate.at(names),
        np.full(len(names), 2e-4), 0.1 * terms.scale,
    )  # fmt: skip
    spread = [*terms.spread(), *[1.0] * 6, 0.0, 0.0, 0.0, 5e-3]
    start = TipState(np.zeros(len(terms.spread())), pose[0], pose[1])
    chosen = choose_touches(rows, TipPrior.of(start, spread), 30)
    chosen = chosen[shortest_order(own[chosen], workspace_of(robot).speed)]
    return plate, (pose[0], pose[1]), [names[k] for k in chosen], approach_sides(30, 3, seed)


def in_block(arm: Arm, seed: int, pose: tuple[Array, Array]) -> Callable[[Calibration], Row]:
    """Judge calibrations by the tip in the block's frame, on one random motion."""
    recording, measured, true, inside = observed(arm, seed)
    chain: Any = arm.robot.kinematics
    there = (chain.forward(true)[:, :3, 3] - pose[1]) @ pose[0]

    def judge(model: Calibration) -> Row:
        joint, facts = measured.copy(), model.metadata["touch"]
        joint[:, :3] = model.correct(recording)
        tip = chain.forward(joint)[:, :3, 3] - np.array(facts["translation"])
        off = np.linalg.norm(tip @ np.array(facts["rotation"]) - there, axis=1)[inside]
        error = (joint - true)[inside, :3]
        return {
            "tip": float(np.sqrt((off**2).mean())),
            "joints": np.sqrt((error**2).mean(axis=0)).tolist(),
            "left_out_error": facts["left_out_error"],
            "left_out": facts["left_out"],
            "scale": facts["scale"],
            "zero_off": np.abs(error.mean(axis=0)).tolist(),
            "zero_sd": facts["zero_sd"],
            "joint_sd": facts["joint_sd"],
        }

    return judge


def nothing_session(specimen: str, seed: int) -> dict[str, Row]:
    """One arm without a first day: clean touches, and wrong ones of the same recording."""
    arm = new_arm(specimen, seed)
    plate, pose, dimples, sides = planned_points(arm, seed)
    recording, touches = touched(arm, plate, pose, dimples, seed, sides)
    minutes = recording.duration / 60
    judge, rng = in_block(arm, seed, pose), np.random.default_rng([seed, 67])
    bad = dict(plate.points)
    for name in rng.choice(dimples, 2, replace=False):
        bad[name] = bad[name] + rng.choice([-1e-3, 1e-3], 3)
    a, b = rng.choice(30, 2, replace=False)
    swapped = list(dimples)
    swapped[a], swapped[b] = swapped[b], swapped[a]
    small = {name: point / 0.995 for name, point in plate.points.items()}
    rows: dict[str, Row] = {}
    for name, block, made in (
        ("clean", plate, touches),
        ("2 badly seated", replace(plate, points=bad), touches),
        ("2 numbers exchanged", plate, replace(touches, dimple=tuple(swapped))),
        ("print .5 % small", replace(plate, points=small, measured=float("nan")), touches),
    ):
        begin = time.perf_counter()
        model, _ = calibrate_by_touch(recording, made, block)
        rows[name] = judge(model) | {"seconds": time.perf_counter() - begin, "minutes": minutes}
    return rows


def main() -> None:
    """Measure, print, and write JSON."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--twins", nargs="+", default=["nominal", "peng2024"])
    parser.add_argument("--arms", type=int, default=10)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--hours", type=float, default=0.0)
    parser.add_argument("--estimators", nargs="+", default=["linear", "rich_play"])
    parser.add_argument("--nothing", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    everything: dict[str, Any] = {}
    for twin in options.twins:
        rows = everything[twin] = []
        for seed in range(options.first, options.first + options.arms):
            rows.append(
                nothing_session(twin, seed)
                if options.nothing
                else session(twin, seed, options.hours, options.estimators)
            )
            shown = {k: round(1e3 * v["tip"], 3) for k, v in rows[-1].items() if "tip" in v}
            print(f"{twin} {seed}: {shown}", flush=True)
            if options.json:
                options.json.write_text(json.dumps(everything, indent=1))
        print(f"\n| {twin} | tip [mm] | worst | shoulder [deg] | elbow [deg] | insertion [mm] |")
        print("|---|---:|---:|---:|---:|---:|")
        for key in dict.fromkeys(key for row in rows for key in row if "tip" in row[key]):
            there = [row[key] for row in rows if key in row]
            tips = [1e3 * row["tip"] for row in there]
            joints = np.array([row["joints"] for row in there]) * DISPLAY
            cells = " | ".join(f"{x:.2f}" for x in np.median(joints, axis=0))
            print(f"| {key} | {np.median(tips):.2f} | {max(tips):.2f} | {cells} |")


if __name__ == "__main__":
    main()
