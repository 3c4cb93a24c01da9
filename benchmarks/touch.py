"""Re-zeroing and calibrating by touching a block, on arms that nobody has seen.

    python -m benchmarks.touch [--nothing] [--twins nominal peng2024] [--arms 10] [--hours 3]

An arm is a specimen of the RAVEN-II twin whose physics are drawn anew: scale, coupling, friction
and stiffness by up to 20 %, zeros by .3 to .5 deg or mm, run-out by any phase. On the first day it
is homed, recorded along zig-zags with joint encoders (13 min), and touches thirty dimples, which
give the block's pose. After a new homing, and again after `--hours` of random motion, six touches,
planned, re-zero the models. What is judged is five minutes of random motion, by the joint positions
that only the twin knows. A touch has .2 mm of noise per axis.

With `--nothing` there are no joint encoders: thirty planned touches, after the homing, calibrate
joints and block together. Judged is the tip in the block's frame, its pose as estimated; again with
two touches 1 mm off in each axis, with two numbers exchanged, with a print .5 % small that nobody
measured, with links whose angles are off by .2 deg, and with the first day of the same arm as a
prior. A twin called ``nominal+loaded`` has another friction.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from benchmarks import head, parsed
from truejoint import Calibration, Recording, calibrate
from truejoint.array_types import Array, Mask
from truejoint.crtk import Arm, SimulatedBackend, StateBlock, TruthBlock
from truejoint.errors import CalibrationError
from truejoint.motion import follow, random_motion, zigzag
from truejoint.motion.touching import SimulatedHand
from truejoint.recordings import Recorder
from truejoint.robots import Robot
from truejoint.robots.chain import SerialChain, reach
from truejoint.robots.parts import Kinematics
from truejoint.simulation import TwinOutput
from truejoint.simulation.raven2.parameters import Raven2Parameters
from truejoint.simulation.raven2.twin import Raven2Twin
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
DISPLAY = np.array([180 / np.pi, 180 / np.pi, 1e3])
FRICTION: dict[str, dict[str, Any]] = {
    # Three times the friction that grows with the load, and five times the way before it slides.
    "loaded": {
        "motor_friction.gear_loss": 0.3,
        "joint_friction.load_share": (0.18, 0.18, 0.18),
        "joint_friction.presliding": (4.4e-3, 8.5e-3, 5e-4),
    }
}


def perturbed(specimen: str, seed: int) -> Raven2Parameters:
    """Physics of an arm of its own, of the kind of a specimen."""
    name, _, friction = specimen.partition("+")
    base, rng = Raven2Parameters.read(name), np.random.default_rng([seed, 41])
    if friction:
        base = base.with_values(FRICTION[friction])

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
        hand.close()
    recording = recorder.recording()
    start = recording.provenance.start
    return recording, Touches(tuple(t - start for t in stamps), tuple(dimples))


def observed(arm: Arm, seed: int) -> Judge:
    """Record five minutes of random motion."""
    motion = random_motion(arm.robot, 300.0, 700 + seed, profile="laboratory")
    blocks: list[StateBlock | TruthBlock] = []
    with Recorder(arm, session="judge") as recorder:
        arm.subscribe(blocks.append)
        follow(arm, motion)
        arm.unsubscribe(blocks.append)
    recording = recorder.recording()
    outputs = [block for block in blocks if isinstance(block, TwinOutput)]
    t, rows = (np.concatenate([getattr(out, name) for out in outputs]) for name in ("t", "joint"))
    stamps = np.array(recording.t) + recording.provenance.start
    measured = recording.columns("measured", arm.robot.joint_names)
    true = measured.copy()
    true[:, :3] = np.column_stack([np.interp(stamps, t, rows[:, k]) for k in range(3)])
    return Judge(recording, measured, true, (stamps >= t[0]) & (stamps <= t[-1]))


@dataclass(frozen=True)
class Judge:
    """Five minutes of random motion: what was measured, and what only the twin knows."""

    recording: Recording
    measured: Array  # (n, all joints)
    true: Array
    counts: Mask


@dataclass(frozen=True)
class Session:
    """All that was recorded of one arm; the estimates are made of it afterwards."""

    training: list[Recording]
    block: Block
    pose: tuple[Array, Array]
    first: tuple[Recording, Touches]  # thirty, planned, on the day of the training
    thirty: tuple[Recording, Touches]  # after the homing
    few: dict[str, tuple[Recording, Touches]]  # six, after the homing and after work
    judges: dict[str, Judge]


def recorded(specimen: str, seed: int, hours: float) -> Session:
    """Record one arm's first day, and what it touches after a homing and after `hours`."""
    arm, training = new_arm(specimen, seed), []
    for direction in ("J1", "J2-J3", "J1-J2-J3"):
        with Recorder(arm, session=direction) as recorder:
            follow(arm, zigzag(arm.robot, direction, 1 / 4))
        training.append(recorder.recording())
    block, pose, dimples, sides = planned_points(arm, seed)
    first = touched(arm, block, pose, dimples, seed, sides)
    judges = {"first day": observed(arm, seed)}
    model = calibrate(training, "linear", random_state=0)
    few = planned(model, first, find_block(model, *first, block)[0])
    six = {}
    arm.home()
    six["homing"] = touched(arm, block, pose, few, 1000 + seed)
    thirty = touched(arm, block, pose, dimples, 2000 + seed, -sides)
    judges["homing"] = observed(arm, seed)
    if hours:
        way = random_motion(arm.robot, hours * 3600.0, 900 + seed, profile="laboratory")
        follow(arm, way)
        six["work"] = touched(arm, block, pose, few, 3000 + seed)
        judges["work"] = observed(arm, seed + 1)
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
    """One arm's rows, by estimator and time: re-zeroed by six touches of a bolted block."""
    rows: dict[str, Row] = {}
    robot = session.training[0].robot
    for name in names:
        model = calibrate(session.training, name, random_state=0)
        block, _ = find_block(model, *session.first, session.block)
        rows[f"{name} full"] = tip_error(robot, session.judges["first day"], model)
        for when, today in session.few.items():
            judge = session.judges[when]
            rows[f"{name} {when} old"] = tip_error(robot, judge, model)
            begin = time.perf_counter()
            try:
                zero, found = zero_by_touch(model, *today, block)
                fresh = model.at(zero)
            except CalibrationError as error:  # whoever touches is asked to touch again
                print(f"  {name} {when}: {error}")
                continue
            rows[f"{name} {when} touched"] = tip_error(robot, judge, fresh) | {
                "seconds": time.perf_counter() - begin, "misfit": found.misfit / found.freedom,
                "left_out": int(found.left_out.sum()), "sd": found.sd[:3].tolist(),
            }  # fmt: skip
    return rows


def in_block(session: Session, model: Calibration, chain: Kinematics) -> Row:
    """Judge a calibration by the tip in the block's frame, of an arm that really is a `chain`."""
    judge, believed = (
        session.judges["homing"],
        session.training[0].robot.known_kinematics("the benchmark"),
    )
    there = (chain.forward(judge.true)[:, :3, 3] - session.pose[1]) @ session.pose[0]
    joint, facts = judge.measured.copy(), model.metadata["touch"]
    joint[:, :3] = model.correct(judge.recording)
    tip = believed.forward(joint)[:, :3, 3] - np.array(facts["translation"])
    off = np.linalg.norm(tip @ np.array(facts["rotation"]) - there, axis=1)[judge.counts]
    hull = Delaunay(session.block.at(tuple(session.block.points)))
    near = off[(hull.find_simplex(there) >= 0)[judge.counts]]
    error = (joint - judge.true)[judge.counts, :3]
    names = ("left_out_rms", "tip_error", "tip_error_sd", "tip_error_workspace", "left_out",
             "scale", "zero_sd", "prior", "not_seen")  # fmt: skip
    return {
        "tip": float(np.sqrt((off**2).mean())),
        "near": float(np.sqrt((near**2).mean())),
        "joints": np.sqrt((error**2).mean(axis=0)).tolist(),
        "zero_off": np.abs(error.mean(axis=0)).tolist(),
        **{name: facts[name] for name in names},
    }


def bent(robot: Robot, degrees: float) -> SerialChain:
    """Kinematics of a robot whose links' angles are off by so much, each to the other side."""
    chain: Any = robot.kinematics
    axes = [
        replace(axis, alpha=axis.alpha + np.deg2rad(degrees) * (-1.0) ** k)
        for k, axis in enumerate(chain.axes)
    ]
    return replace(chain, axes=axes)  # type: ignore[no-any-return]


def touched_by(session: Session, robot: Robot, chain: SerialChain) -> Block:
    """Block whose dimples are where the tip had rested, were the arm a `chain`."""
    rotation, translation = session.pose
    names = tuple(session.block.points)
    joint, _ = reach(robot, session.block.at(names) @ rotation.T + translation, robot.home)
    points = (chain.forward(joint)[:, :3, 3] - translation) @ rotation
    return replace(session.block, points=dict(zip(names, points, strict=True)))


def nothing_rows(session: Session, seed: int) -> dict[str, Row]:
    """One arm's rows without joint sensors: clean touches, and wrong ones of the same recording."""
    (recording, touches), block = session.thirty, session.block
    rng, dimples = np.random.default_rng([seed, 67]), list(dict.fromkeys(touches.dimple))
    bad = dict(block.points)
    for name in rng.choice(dimples, 2, replace=False):
        bad[name] = bad[name] + rng.choice([-1e-3, 1e-3], 3)
    a, b = rng.choice(dimples, 2, replace=False).tolist()
    swapped = replace(touches, dimple=tuple({a: b, b: a}.get(n, n) for n in touches.dimple))
    unseated = replace(block, points=bad)
    unmeasured = replace(block, measured=float("nan"))
    small = replace(unmeasured, points={name: p / 0.995 for name, p in block.points.items()})
    robot, older = recording.robot, calibrate(session.training, "linear", random_state=0)
    straight, crooked = robot.known_kinematics("the benchmark"), bent(robot, 0.2)

    def touch(*given: Any, known: Calibration | None = None) -> Calibration:
        return calibrate_by_touch(*given, prior=known)[0]

    cases: dict[str, tuple[Kinematics, Callable[[], Calibration]]] = {
        "clean": (straight, lambda: touch(recording, touches, block)),
        "2 badly seated": (straight, lambda: touch(recording, touches, unseated)),
        "2 numbers exchanged": (straight, lambda: touch(recording, swapped, block)),
        "print .5 % small": (straight, lambda: touch(recording, touches, small)),
        "older": (straight, lambda: touch(recording, touches, block, known=older)),
        "older, small": (straight, lambda: touch(recording, touches, small, known=older)),
        "links .2 deg off": (
            crooked, lambda: touch(recording, touches, touched_by(session, robot, crooked))
        ),
    }  # fmt: skip
    rows: dict[str, Row] = {}
    for name, (chain, make) in cases.items():
        begin = time.perf_counter()
        try:
            model = make()
        except CalibrationError as error:
            print(f"  {name}: {error}")
            continue
        rows[name] = {"seconds": time.perf_counter() - begin} | in_block(session, model, chain)
    return rows


def main() -> None:
    """Measure and print."""
    options = parsed(
        __doc__, twins=["nominal", "peng2024"], arms=10, first=100, hours=0.0,
        estimators=["linear", "rich_play"], nothing=False,
    )  # fmt: skip
    for twin in options.twins:
        rows: list[dict[str, Row]] = []
        for seed in range(options.first, options.first + options.arms):
            session = recorded(twin, seed, options.hours)
            rows.append(
                nothing_rows(session, seed)
                if options.nothing
                else rezero_rows(session, options.estimators)
            )
            shown = {k: round(1e3 * v["tip"], 3) for k, v in rows[-1].items()}
            print(f"{twin} {seed}: {shown}", flush=True)
        print_table(twin, rows)
        if options.nothing:
            print_honesty(twin, rows)


def print_table(twin: str, rows: list[dict[str, Row]]) -> None:
    """Print median and worst tip and joints, over arms, of each row."""
    print()
    head(twin, "tip [mm]", "worst", "shoulder [deg]", "elbow [deg]", "insertion [mm]")
    for key in dict.fromkeys(key for row in rows for key in row):
        there = [row[key] for row in rows if key in row]
        tips = [1e3 * row["tip"] for row in there]
        joints = np.array([row["joints"] for row in there]) * DISPLAY
        cells = " | ".join(f"{x:.2f}" for x in np.median(joints, axis=0))
        count = f" ({len(there)} arms)" if len(there) < len(rows) else ""
        print(f"| {key}{count} | {np.median(tips):.2f} | {max(tips):.2f} | {cells} |")


def print_honesty(twin: str, rows: list[dict[str, Row]]) -> None:
    """Print what was stated against what was true, and how much worse than clean each case is."""
    print()
    head(
        twin, "to clean", "worst", "near [mm]", "stated / true near", "within 1.6", "workspace",
        "within 1.6", "zeros in 90 %", "prior used", "left out",
    )  # fmt: skip
    for key in dict.fromkeys(key for row in rows for key in row):
        there = [row[key] for row in rows if key in row]
        ratio = [row[key]["tip"] / row["clean"]["tip"] for row in rows if key in row]
        near, far = (
            np.array([row[stated] / row[true] for row in there])
            for stated, true in (("tip_error", "near"), ("tip_error_workspace", "tip"))
        )
        off = np.array([row["zero_off"] for row in there])
        inside = off < 1.645 * np.array([row["zero_sd"] for row in there])
        cells = [
            f"{np.median(values):.2f} | {int((np.abs(np.log(values)) < np.log(1.6)).sum())}"
            for values in (near, far)
        ]
        true = 1e3 * np.median([row["near"] for row in there])
        print(
            f"| {key} | {np.median(ratio):.2f} | {max(ratio):.2f} | {true:.2f} "
            f"| {' | '.join(cells)} | {int(inside.sum())} of {inside.size} "
            f"| {sum(bool(row['prior']) for row in there)} "
            f"| {np.mean([len(row['left_out']) for row in there]):.1f} |"
        )


if __name__ == "__main__":
    main()
