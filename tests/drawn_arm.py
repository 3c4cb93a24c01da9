"""RAVEN-II arms drawn by a seed, their touches, and what may be wrong with these; no twin."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint import Calibration, calibrate
from truejoint.array_types import Array
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.robots.chain import reach
from truejoint.tip import Block, Touches, design_block

ROBOT = get_robot("raven2", "left")
SPACE = ROBOT.workspace
PRINTED = design_block(ROBOT).block()
RATE = 30.0
NOISE: Final = {"block": 2e-4, "tracker": 2.5e-4}
"""What a touch and a shot err, per axis [m]."""
_WAY, _REST = 15, 15  # rows of each way, and of a rest
_AWAY = 0.06  # of the workspace, from where a joint comes
_UNIT = np.array([np.deg2rad(1.0), np.deg2rad(1.0), 1e-3])


@dataclass
class DrawnArm:
    """An arm whose joints are elsewhere than measured, each error drawn by the `seed`.

    `moved` (3,) [m] is added to where the block really stands, and `homing` (3,) [rad or m] to
    where the joints are.
    """

    seed: int
    moved: Array = field(default_factory=lambda: np.zeros(3))
    homing: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        rng = np.random.default_rng([self.seed, 3])
        # Zeros of 2 deg or mm, 2 % of scale, 1 % of coupling, up to .3 deg or mm of stretch and of
        # backlash to either side.
        self.zero = 2.0 * _UNIT * rng.standard_normal(3)
        self.scale = 1.0 + 0.02 * rng.standard_normal(3)
        coupling = 0.01 * rng.standard_normal((3, 3)) * np.outer(_UNIT, 1.0 / _UNIT)
        self.coupling = coupling - np.diag(np.diag(coupling))
        self.stretch = rng.uniform(0.05, 0.3, 3) * _UNIT
        # Run-out, which no term follows, of up to .1 deg or mm and a turn every 12 deg or mm.
        self.run_out = rng.uniform(0.0, 0.1, 3) * _UNIT
        self.phase = rng.uniform(-np.pi, np.pi, 3)
        self.backlash = rng.uniform(0.02, 0.3, 3) * _UNIT
        self.down = Rotation.from_rotvec(0.3 * rng.standard_normal(3)).apply([0.0, 0.0, -1.0])
        tilt = Rotation.from_rotvec(0.05 * rng.standard_normal(3)).as_matrix()
        self.rotation = tilt @ PRINTED.rotation
        self.translation = PRINTED.translation + 3e-3 * rng.standard_normal(3)

    def joints(self, loosened: Array) -> Array:
        """Where joints (m, 7) are of which motors, less their backlash, are (m, 7)."""
        q, true = loosened[:, :3] - SPACE.centre, loosened.copy()
        pull = np.einsum("i,mij->mj", self.down, ROBOT.kinematics.jacobian(loosened)[:, :3, :3])
        pull /= [0.1, 0.1, 1.0]  # of a metre, or of the whole weight
        error = self.zero + self.homing + (self.scale - 1.0) * q + q @ self.coupling.T
        turning = np.sin(2.0 * np.pi * q / (12.0 * _UNIT) + self.phase)
        true[:, :3] += error + self.stretch * pull + self.run_out * turning
        return true

    def motors(self, joint: Array, side: Array) -> Array:
        """Positions (m, 7) that bring the joints there (m, 7) from the sides (m, 3)."""
        motor = joint.copy()
        for _ in range(30):
            loosened = motor.copy()
            loosened[:, :3] += side * self.backlash
            motor[:, :3] += (joint - self.joints(loosened))[:, :3]
        return motor

    def rests(self, joint: Array, side: Array) -> tuple[Recording, Array]:
        """Record rests at joints (m, 7), each come to from sides (m, 3); and the true joints."""
        there = self.motors(joint, side)
        away = there.copy()
        away[:, :3] += _AWAY * SPACE.extent * side
        share = np.linspace(0.0, 1.0, _WAY)[:, None]
        rows, before = [], away[0]
        for rest, start in zip(there, away, strict=True):
            rows += [before + share * (start - before), start + share * (rest - start)]
            rows.append(np.tile(rest, (_REST, 1)))
            before = rest
        motor = np.concatenate(rows)
        loosened = motor.copy()
        low, high = motor[:, :3] - self.backlash, motor[:, :3] + self.backlash
        held = loosened[0, :3] + side[0] * self.backlash
        for k in range(len(motor)):
            held = np.clip(held, low[k], high[k])
            loosened[k, :3] = held
        columns = {"t": np.arange(len(motor)) / RATE}
        columns |= {f"measured/{n}": motor[:, k] for k, n in enumerate(ROBOT.joint_names)}
        about = Provenance("raven2", "left", source=f"arm {self.seed}", homing_id="1")
        return Recording.from_columns(columns, about), self.joints(loosened)

    def model(self) -> Calibration:
        """Linear model by joint encoders, of rests all over the workspace."""
        rng = np.random.default_rng([self.seed, 21])
        recording, true = self.rests(anywhere(rng, 80), rng.choice([-1.0, 1.0], (80, 3)))
        columns = {"t": recording.t} | {c: recording.column(c) for c in recording.units}
        columns |= {f"truth/{name}": true[:, k] for k, name in enumerate(SPACE.joints)}
        return calibrate([Recording.from_columns(columns, recording.provenance)], "linear")


def stamps(m: int) -> tuple[float, ...]:
    """Ends of `m` rests [s]."""
    size = 2 * _WAY + _REST
    return tuple(((size * np.arange(m) + size - 1) / RATE).tolist())


def anywhere(rng: np.random.Generator, count: int) -> Array:
    """Joints (count, 7) all over the workspace."""
    joint = np.tile(ROBOT.home, (count, 1))
    joint[:, :3] = SPACE.centre + 0.48 * SPACE.extent * rng.uniform(-1.0, 1.0, (count, 3))
    return joint


def all_sides(rng: np.random.Generator, count: int) -> Array:
    """Sides (count, 3) from which joints come, as often from either."""
    every = np.array(list(product((-1.0, 1.0), repeat=3)) * (-(-count // 8)))
    return rng.permutation(every)[:count]


def joints_at(tip: Array) -> Array:
    """Joints (m, 7) that take the tip to points (m, 3) of the base [m]."""
    seed = ROBOT.home.copy()
    seed[:3] = SPACE.centre
    joint, there = reach(ROBOT.kinematics, [0, 1, 2], tip, seed)
    assert there.all()
    return joint


@dataclass(frozen=True)
class Session:
    """Touches or shots of an arm, and where the block or the tracker really is."""

    arm: DrawnArm
    recording: Recording
    touches: Touches
    block: Block
    rotation: Array  # in the base
    translation: Array

    def tip_error(self, model: Calibration, *, near: bool, count: int = 60) -> float:
        """RMS error [m] of the tip in the block's frame as it was found, on other rests.

        They are in the block's dimples or at the shots if `near`, else all over the workspace.
        """
        rng = np.random.default_rng([self.arm.seed, 5])
        side = rng.choice([-1.0, 1.0], (count, 3))
        joint = anywhere(rng, count)
        if near:
            point = PRINTED.at(tuple(rng.choice(list(PRINTED.points), count)))
            if not self.block.robot:
                point = self.block.at(tuple(rng.choice(list(self.block.points), count)))
            joint = joints_at(point @ self.rotation.T + self.translation)
        recording, true = self.arm.rests(joint, side)
        at = np.searchsorted(recording.t, np.array(stamps(count)) - 1e-6)
        facts = model.metadata["touch"]
        found = recording.columns("measured", ROBOT.joint_names)
        found[:, :3] = model.correct(recording)
        tips = [ROBOT.kinematics.forward(joint[at])[:, :3, 3] for joint in (found, true)]
        seen = (tips[0] - np.array(facts["translation"])) @ np.array(facts["rotation"])
        off = seen - (tips[1] - self.translation) @ self.rotation
        return float(np.sqrt((off**2).sum(axis=1).mean()))


def block_session(
    arm: DrawnArm, m: int = 30, repeats: int = 6, *, step: Array | None = None, references: int = 0,
    day: int = 0, noise: float = NOISE["block"],
) -> Session:  # fmt: skip
    """Touch `m` dimples of the printed block from all sides, some of them once more at once.

    The block moves by `step` (3,) [m] amid the touches. Afterwards references, which stay where
    they were whatever the arm's `moved` is, are touched.
    """
    rng, own = np.random.default_rng([arm.seed, 11, day]), np.random.default_rng([arm.seed, 17])
    named = rng.permutation(list(PRINTED.points))[:m].tolist()
    order = np.sort(np.concatenate([np.arange(m), rng.permutation(m)[:repeats]]))
    order = np.concatenate([order, m + np.arange(references)])
    centre = PRINTED.at(tuple(PRINTED.points)).mean(axis=0)
    places = {f"R{k}": centre + 0.025 * own.uniform(-1.0, 1.0, 3) for k in range(references)}
    block = replace(PRINTED, measured=PRINTED.calliper, references=places)
    dimples = tuple([*named, *places][k] for k in order)
    point = block.at(dimples) + noise * rng.standard_normal((len(order), 3))
    point[np.isin(dimples, list(places))] -= arm.moved @ arm.rotation
    if step is not None:
        point[len(order) // 2 :] += step
    translation = arm.translation + arm.moved
    joint = joints_at(point @ arm.rotation.T + translation)
    recording, _ = arm.rests(joint, all_sides(rng, m + references)[order])
    touches = Touches(stamps(len(order)), dimples)
    return Session(arm, recording, touches, block, arm.rotation, translation)


def tracker_session(
    arm: DrawnArm, m: int = 30, repeats: int = 6, *, marker: Array | None = None,
    noise: float = NOISE["tracker"],
) -> Session:  # fmt: skip
    """Shots of a tracker at `m` rests all over the workspace, at some of them two.

    With a `marker` (3,) [m] off the tip, roll and wrist are elsewhere at each rest.
    """
    rng = np.random.default_rng([arm.seed, 13])
    joint, side = anywhere(rng, m), all_sides(rng, m)
    if marker is not None:
        joint[:, 3:] += 0.4 * rng.uniform(-1.0, 1.0, (m, len(ROBOT.joints) - 3))
    order = np.sort(np.concatenate([np.arange(m), rng.permutation(m)[:repeats]]))
    recording, true = arm.rests(joint[order], side[order])
    at = np.searchsorted(recording.t, np.array(stamps(len(order))) - 1e-6)
    tool = ROBOT.kinematics.forward(true[at])
    seen = tool[:, :3, 3] + tool[:, :3, :3] @ (np.zeros(3) if marker is None else marker)
    rotation = Rotation.random(rng=rng).as_matrix()
    translation = tool[:, :3, 3].mean(axis=0) + rng.uniform(-0.02, 0.02, 3)
    seen = (seen - translation) @ rotation + noise * rng.standard_normal((len(at), 3))
    points = {str(k): p for k, p in enumerate(seen, 1)}
    touches = Touches(stamps(len(order)), tuple(points), "shots.csv")
    block = Block("shots.csv", "", points, 0.99, 0.99)
    return Session(arm, recording, touches, block, rotation, translation)


def _with_points(session: Session, factor: Array | float, measured: float = np.nan) -> Session:
    block, points = session.block, {n: p * factor for n, p in session.block.points.items()}
    if not block.robot:
        measured = block.measured
    return replace(session, block=replace(block, points=points, measured=measured))


def _renamed(session: Session, order: list[str]) -> Session:
    names = dict(zip(PRINTED.points, order, strict=True))
    dimples = tuple(names[name] for name in session.touches.dimple)
    return replace(session, touches=replace(session.touches, dimple=dimples))


def way(seed: int, millimetres: float) -> Array:
    """Way (3,) of so many millimetres in a random direction [m]."""
    way = np.random.default_rng([seed, 77]).standard_normal(3)
    return 1e-3 * millimetres * way / np.linalg.norm(way)


_NAMES = list(PRINTED.points)
_BY_Y = sorted(_NAMES, key=lambda name: PRINTED.points[name].round(6).tolist()[1::-1])
_ALONG_Y = [_NAMES[_BY_Y.index(name)] for name in _NAMES]
CALLIPER = PRINTED.calliper
FAULTS: Final[Mapping[tuple[str, str], tuple[Callable[[DrawnArm], Session], str]]] = {
    **{
        ("block", f"mirrored in {axis}"): (
            lambda arm, k=k: _with_points(block_session(arm), 1.0 - 2.0 * np.eye(3)[k], CALLIPER),
            f"mirrored in {axis}",
        )
        for k, axis in enumerate("xyz")
    },
    ("block", "1 % larger, unmeasured"): (
        lambda arm: _with_points(block_session(arm), 1.01), "size of the print"
    ),
    ("block", "1 % larger, measured wrongly"): (
        lambda arm: _with_points(block_session(arm), 1.01, CALLIPER), "size of the print"
    ),
    ("block", "numbered from the end"): (
        lambda arm: _renamed(block_session(arm), _NAMES[::-1]), "numbered otherwise"
    ),
    ("block", "numbered along y"): (
        lambda arm: _renamed(block_session(arm), _ALONG_Y), "numbered otherwise"
    ),
    ("block", "numbered one further"): (
        lambda arm: _renamed(block_session(arm), [*_NAMES[1:], _NAMES[0]]), "numbered otherwise"
    ),
    ("block", "numbered at random"): (
        lambda arm: _renamed(
            block_session(arm), np.random.default_rng(arm.seed).permutation(_NAMES).tolist()
        ),
        "do not",
    ),
    **{
        ("block", f"moved by {mm:g} mm amid"): (
            lambda arm, mm=mm: block_session(arm, step=way(arm.seed, mm)), "moves by"
        )
        for mm in (0.5, 1.0, 2.0, 5.0)
    },
    ("tracker", "mirrored"): (
        lambda arm: _with_points(tracker_session(arm), np.array([1.0, 1.0, -1.0])), "mirrored"
    ),
    ("tracker", "1 % larger"): (
        lambda arm: _with_points(tracker_session(arm), 1.01), "size of the frame"
    ),
    ("tracker", "marker 3 mm off, wrist moves"): (
        lambda arm: tracker_session(arm, marker=way(arm.seed, 3.0)), "off the tip"
    ),
    ("tracker", "marker 10 mm off, wrist moves"): (
        lambda arm: tracker_session(arm, marker=way(arm.seed, 10.0)), "off the tip"
    ),
}  # fmt: skip
"""By kind and name what makes a session in which something is wrong, and the words that name it."""
