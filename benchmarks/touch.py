"""Re-zeroing and calibrating by touching a block, on arms that nobody has seen.

    python -m benchmarks.touch [--nothing] [--twins nominal peng2024] [--arms 10]

An arm is a specimen of the RAVEN-II twin whose physics are drawn anew: scale, coupling, friction
and stiffness by up to 20 %, zeros by .3 to .5 deg or mm, run-out by any phase. On the first day it
is homed, recorded along zig-zags with joint encoders (13 min), and touches thirty dimples, which
give the block's pose. After a new homing six touches, planned, re-zero the models. What is judged
is five minutes of random motion, by the joint positions that only the twin knows. A touch has .2 mm
of noise per axis.

With `--nothing` there are no joint encoders: thirty planned touches, after the homing, calibrate
joints and block together. Judged is the tip in the block's frame, its pose as estimated; again with
two touches 1 mm off in each axis, with a print .5 % small that nobody measured, and with the first
day of the same arm as a prior.
"""

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from benchmarks import head, parsed, row
from benchmarks.arms import blocks_of, homed, recorded
from truejoint import Calibration, Recording, calibrate
from truejoint.array_types import Array, Mask
from truejoint.crtk import Arm, SimulatedBackend
from truejoint.errors import CalibrationError
from truejoint.motion import random_motion, zigzag
from truejoint.motion.touching import SimulatedHand
from truejoint.recordings import Recorder
from truejoint.robots import Robot
from truejoint.simulation import TwinOutput
from truejoint.simulation.raven2 import Raven2Parameters, Raven2Twin
from truejoint.tip import (
    Block,
    BlockPose,
    Touches,
    calibrate_by_touch,
    design_block,
    find_block,
    zero_by_touch,
)
from truejoint.tip.plan import choose_touches, design_pose, learning
from truejoint.tip.touch import tip_rows, zero_prior

Row = dict[str, Any]
FEW = 6  # touches that re-zero
PERTURBED = (
    "pulleys.scale", "pulleys.coupling_shoulder_elbow", "pulleys.coupling_shoulder_insertion",
    "pulleys.coupling_elbow_insertion", "motor_friction.coulomb", "joint_friction.coulomb",
    "cable.stiffness",
)  # fmt: skip


def perturbed(specimen: str, seed: int) -> Raven2Parameters:
    """Physics of an arm of its own, of the kind of a specimen."""
    base, rng = Raven2Parameters.read(specimen), np.random.default_rng([seed, 41])

    def by(values: Any) -> Any:
        sizes = np.asarray(values) * (1.0 + rng.uniform(-0.2, 0.2, np.shape(values)))
        return tuple(sizes.tolist()) if np.ndim(values) else float(sizes)

    phases = rng.uniform(-np.pi, np.pi, (2, 3))
    zero = np.deg2rad([0.3, 0.5, 0.0]) * rng.standard_normal(3)
    zero[2] = 4e-4 * rng.standard_normal()
    bias = np.array(base.homing.registration_bias) + zero
    return base.with_values(
        {
            **{name: by(attrgetter(name)(base)) for name in PERTURBED},
            "pulleys.capstan_phase": tuple(phases[0].tolist()),
            "pulleys.joint_phase": tuple(phases[1].tolist()),
            "homing.registration_bias": tuple(bias.tolist()),
        }
    )


def new_arm(specimen: str, seed: int) -> Arm:
    """Arm of a perturbed specimen, homed."""
    return homed(Arm(SimulatedBackend(Raven2Twin(perturbed(specimen, seed), seed=seed))))


def printed_block(arm: Arm, seed: int) -> tuple[Block, Array, Array]:
    """Block as `truejoint touch block` designs it, measured, and its pose: nearly as meant."""
    block, rng = design_block(arm.robot).block(), np.random.default_rng([seed, 43])
    turn = Rotation.from_rotvec(0.03 * rng.standard_normal(3)).as_matrix()
    shift = 2e-3 * rng.standard_normal(3)
    measured = replace(block, measured=block.calliper)
    return measured, turn @ block.rotation, block.translation + shift


def touched(
    arm: Arm, block: Block, pose: tuple[Array, Array], dimples: list[str], seed: int,
    sides: Array | None = None,
) -> tuple[Recording, Touches]:  # fmt: skip
    """Record an arm that touches dimples, each from a random side unless `sides` say it."""
    if sides is None:
        sides = np.random.default_rng([seed, 47]).choice([-1.0, 1.0], (len(dimples), 3))
    with Recorder(arm, session="touches") as recorder:
        hand = SimulatedHand(arm, *pose, seed=seed)
        pairs = zip(dimples, sides, strict=True)
        stamps = [hand.touch(block.points[n], side) for n, side in pairs]
    recording = recorder.recording()
    start = recording.provenance.start
    return recording, Touches(tuple(t - start for t in stamps), tuple(dimples))


@dataclass(frozen=True)
class Judge:
    """Five minutes of random motion: what was measured, and what only the twin knows."""

    recording: Recording
    measured: Array  # (n, all joints)
    true: Array
    counts: Mask


def observed(arm: Arm, seed: int) -> Judge:
    """Record five minutes of random motion."""
    motion = random_motion(arm.robot, 300.0, 700 + seed, profile="laboratory")
    with blocks_of(arm, TwinOutput) as outputs:
        recording = recorded(arm, motion, session="judge")
    t, rows = (np.concatenate([getattr(out, name) for out in outputs]) for name in ("t", "joint"))
    stamps = np.array(recording.t) + recording.provenance.start
    measured = recording.columns("measured", arm.robot.joint_names)
    true = measured.copy()
    true[:, :3] = np.column_stack([np.interp(stamps, t, rows[:, k]) for k in range(3)])
    return Judge(recording, measured, true, (stamps >= t[0]) & (stamps <= t[-1]))


@dataclass(frozen=True)
class Session:
    """All that was recorded of one arm; the estimates are made of it afterwards."""

    training: list[Recording]
    block: Block
    pose: tuple[Array, Array]
    first: tuple[Recording, Touches]  # thirty, planned, on the day of the training
    thirty: tuple[Recording, Touches]  # after the homing
    few: tuple[Recording, Touches]  # six, after the homing
    judges: dict[str, Judge]


def one_session(specimen: str, seed: int) -> Session:
    """Record one arm's first day, and what it touches after a homing."""
    arm = new_arm(specimen, seed)
    training = [
        recorded(arm, zigzag(arm.robot, direction, 1 / 4), session=direction)
        for direction in ("J1", "J2-J3", "J1-J2-J3")
    ]
    block, pose, dimples, sides = planned_points(arm, seed)
    first = touched(arm, block, pose, dimples, seed, sides)
    judges = {"first day": observed(arm, seed)}
    model = calibrate(training, "linear", random_state=0)
    few = planned(model, first, find_block(model, *first, block)[0])
    arm.home()
    six = touched(arm, block, pose, few, 1000 + seed)
    thirty = touched(arm, block, pose, dimples, 2000 + seed, -sides)
    judges["homing"] = observed(arm, seed)
    return Session(training, block, pose, first, thirty, six, judges)


def tip_error(robot: Robot, judge: Judge, model: Calibration) -> Row:
    """RMS error [m] of the tip in the robot's base, and (3,) of the joints, on random motion."""
    chain, joint = robot.known_kinematics("the benchmark"), judge.measured.copy()
    joint[:, :3] = model.correct(judge.recording)
    off = (chain.forward(joint)[:, :3, 3] - chain.forward(judge.true)[:, :3, 3])[judge.counts]
    error = (joint - judge.true)[judge.counts, :3]
    return {
        "tip": float(np.sqrt((off**2).sum(axis=1).mean())),
        "joints": np.sqrt((error**2).mean(axis=0)).tolist(),
    }


def planned(model: Calibration, day: tuple[Recording, Touches], block: BlockPose) -> list[str]:
    """Six of the dimples touched on the first day that tell most of the zeros."""
    rows = tip_rows(model, *day, block.block)
    homing = np.array([*np.deg2rad([1.0, 1.0]), 1e-3])
    first = [day[1].dimple.index(name) for name in dict.fromkeys(day[1].dimple)]
    once = rows.rows(np.isin(np.arange(len(rows)), first))
    chosen = choose_touches(once, zero_prior(block, homing), FEW)
    return [day[1].dimple[first[k]] for k in chosen]


def planned_points(arm: Arm, seed: int) -> tuple[Block, tuple[Array, Array], list[str], Array]:
    """Thirty dimples that tell most, six of them twice, in order, their pose and the sides."""
    block, *pose = printed_block(arm, seed)
    robot = arm.robot
    stops = learning(robot, design_pose(block, robot)).plan(30, seed)
    names, sides = [stop.dimple for stop in stops], np.array([stop.side for stop in stops])
    return block, (pose[0], pose[1]), names, sides


def rezero_rows(session: Session, names: list[str]) -> dict[str, Row]:
    """One arm's rows, by estimator: re-zeroed by six touches of a bolted block."""
    rows, robot, judge = dict[str, Row](), session.training[0].robot, session.judges["homing"]
    for name in names:
        model = calibrate(session.training, name, random_state=0)
        block, _ = find_block(model, *session.first, session.block)
        rows[f"{name} full"] = tip_error(robot, session.judges["first day"], model)
        rows[f"{name} old"] = tip_error(robot, judge, model)
        try:
            fresh = model.at(zero_by_touch(model, *session.few, block)[0])
        except CalibrationError as error:  # whoever touches is asked to touch again
            print(f"  {name}: {error}")
            continue
        rows[f"{name} touched"] = tip_error(robot, judge, fresh)
    return rows


def in_block(session: Session, model: Calibration) -> Row:
    """Judge a calibration by the tip in the block's frame."""
    judge, robot = session.judges["homing"], session.training[0].robot
    chain = robot.known_kinematics("the benchmark")
    there = (chain.forward(judge.true)[:, :3, 3] - session.pose[1]) @ session.pose[0]
    joint, facts = judge.measured.copy(), model.metadata["touch"]
    joint[:, :3] = model.correct(judge.recording)
    tip = chain.forward(joint)[:, :3, 3] - np.array(facts["translation"])
    off = np.linalg.norm(tip @ np.array(facts["rotation"]) - there, axis=1)[judge.counts]
    hull = Delaunay(session.block.at(tuple(session.block.points)))
    near = off[(hull.find_simplex(there) >= 0)[judge.counts]]
    error = (joint - judge.true)[judge.counts, :3]
    return {
        "tip": float(np.sqrt((off**2).mean())),
        "near": float(np.sqrt((near**2).mean())),
        "joints": np.sqrt((error**2).mean(axis=0)).tolist(),
        **{name: facts[name] for name in ("tip_error", "tip_error_workspace")},
    }


def nothing_rows(session: Session, seed: int) -> dict[str, Row]:
    """One arm's rows without joint sensors: clean touches, and wrong ones of the same recording."""
    (recording, touches), block = session.thirty, session.block
    rng, dimples = np.random.default_rng([seed, 67]), list(dict.fromkeys(touches.dimple))
    bad = dict(block.points)
    for name in rng.choice(dimples, 2, replace=False):
        bad[name] = bad[name] + rng.choice([-1e-3, 1e-3], 3)
    unseated = replace(block, points=bad)
    unmeasured = replace(block, measured=float("nan"))
    small = replace(unmeasured, points={name: p / 0.995 for name, p in block.points.items()})
    older = calibrate(session.training, "linear", random_state=0)
    cases: dict[str, tuple[Block, Calibration | None]] = {
        "clean": (block, None),
        "2 badly seated": (unseated, None),
        "print .5 % small": (small, None),
        "older": (block, older),
    }
    rows: dict[str, Row] = {}
    for name, (taken, prior) in cases.items():
        try:
            model, _ = calibrate_by_touch(recording, touches, taken, prior=prior)
        except CalibrationError as error:
            print(f"  {name}: {error}")
            continue
        rows[name] = in_block(session, model)
    return rows


def main() -> None:
    """Measure and print."""
    options = parsed(
        __doc__, twins=["nominal", "peng2024"], arms=10, first=100,
        estimators=["linear", "rich_play"], nothing=False,
    )  # fmt: skip
    for twin in options.twins:
        rows: list[dict[str, Row]] = []
        for seed in range(options.first, options.first + options.arms):
            session = one_session(twin, seed)
            if options.nothing:
                rows.append(nothing_rows(session, seed))
            else:
                rows.append(rezero_rows(session, options.estimators))
            shown = {k: round(1e3 * v["tip"], 3) for k, v in rows[-1].items()}
            print(f"{twin} {seed}: {shown}", flush=True)
        print_table(twin, rows)
        if options.nothing:
            print_honesty(twin, rows)


def print_table(twin: str, rows: list[dict[str, Row]]) -> None:
    """Print median and worst tip and joints, over arms, of each row."""
    print()
    head(twin, "tip [mm]", "worst", "shoulder [deg]", "elbow [deg]", "insertion [mm]")
    for key in dict.fromkeys(key for arm in rows for key in arm):
        there = [arm[key] for arm in rows if key in arm]
        tips = [1e3 * own["tip"] for own in there]
        joints = np.array([own["joints"] for own in there]) * [180 / np.pi, 180 / np.pi, 1e3]
        count = f" ({len(there)} arms)" if len(there) < len(rows) else ""
        numbers = np.median(tips), max(tips), *np.median(joints, axis=0)
        row(f"{key}{count}", *(f"{x:.2f}" for x in numbers))


def print_honesty(twin: str, rows: list[dict[str, Row]]) -> None:
    """Print what was stated against what was true, near the block and all over the workspace."""
    print()
    head(twin, "near [mm]", "stated / true", "within 1.6", "workspace [mm]", "stated / true",
         "within 1.6")  # fmt: skip
    for key in dict.fromkeys(key for arm in rows for key in arm):
        there, cells = [arm[key] for arm in rows if key in arm], []
        for stated, true in (("tip_error", "near"), ("tip_error_workspace", "tip")):
            ratios = np.array([own[stated] / own[true] for own in there])
            inside = int((np.abs(np.log(ratios)) < np.log(1.6)).sum())
            error = 1e3 * np.median([own[true] for own in there])
            cells += [f"{error:.2f}", f"{np.median(ratios):.2f}", f"{inside}"]
        row(key, *cells)


if __name__ == "__main__":
    main()
