"""A RAVEN-II that touches dimples of a block, of numbers alone."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint import Calibration, calibrate
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.tip import Block, Touches

ROBOT = get_robot("raven2", "left")
ROTATION = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
RATE = 30.0


def error_of(joint: np.ndarray) -> np.ndarray:
    """True less measured position (n, 3) of positions (n, 7), nearly linear."""
    q = (joint[:, :3] - ROBOT.workspace.centre) / ROBOT.workspace.extent
    bent = 0.02 * (q @ np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.2], [0.1, 0.0, 1.0]]) + 0.5)
    return (bent + 2e-3 * q**2) * [1.0, 1.0, 0.1]


def recorded(joint: np.ndarray, offset: np.ndarray, **about: str) -> Recording:
    """Recording of positions (n, 7), the truth beside them."""
    columns = {"t": np.arange(len(joint)) / RATE}
    truth = joint[:, :3] + error_of(joint) + offset
    for k, name in enumerate(ROBOT.joint_names):
        columns[f"measured/{name}"] = joint[:, k]
        columns[f"effort/{name}"] = np.sin(columns["t"] + k)
        if k < 3:
            columns[f"truth/{name}"] = truth[:, k]
    about = {"source": "touched", "homing_id": "1", "arm": "left"} | about
    return Recording.from_columns(columns, Provenance("raven2", **about))


def wandering(n: int, seed: int) -> np.ndarray:
    """Positions (n, 7) all over the workspace."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / RATE
    joint = np.tile(ROBOT.home, (n, 1))
    waves = np.sin(t[:, None] * rng.uniform(0.2, 0.9, 3) + rng.uniform(0, 6, 3))
    joint[:, :3] = ROBOT.workspace.centre + 0.48 * ROBOT.workspace.extent * waves
    joint[:, 3:] += 0.01 * np.sin(t[:, None] * rng.uniform(0.2, 0.9, 4))
    return joint


@cache
def fitted() -> Calibration:
    """Linear model of such an arm, with truth of every row."""
    joint = wandering(3000, 1)
    return calibrate([recorded(joint, np.zeros(3))], "linear")


@dataclass(frozen=True)
class Touched:
    """Touches of a block, and what was recorded of the arm meanwhile."""

    recording: Recording
    touches: Touches
    block: Block
    translation: np.ndarray


def touched(
    m: int = 12, seed: int = 0, *, offset: tuple[float, ...] = (0.0, 0.0, 0.0),
    noise: float = 1e-4, block: Block | None = None, dimples: list[str] | None = None, **about: str,
) -> Touched:  # fmt: skip
    """Rest in `m` dimples, where the measured positions are off by `offset` beyond the first day.

    Without a `block` the dimples are where the arm goes; with one they are some of its, those
    called `dimples` if given.
    """
    offset_ = np.array(offset)
    # The dimples of the block are those of seed 0; the arm finds them whatever its offset.
    rng = np.random.default_rng(seed)
    count = m if block is None else len(block.points)
    places = np.tile(ROBOT.home, (count, 1))
    grid = np.random.default_rng(99).uniform(-0.45, 0.45, (count, 3))
    places[:, :3] = ROBOT.workspace.centre + ROBOT.workspace.extent * grid
    true = places.copy()
    true[:, :3] += error_of(places)
    tip = ROBOT.kinematics.forward(true)[:, :3, 3]
    translation = tip[0].copy()
    points = (tip - translation) @ ROTATION
    if block is None:
        named = {str(k + 1): p for k, p in enumerate(points)}
        block = Block("test block", "raven2", named, 0.08, 0.08, ROTATION, translation)
    chosen = rng.permutation(count)[:m]
    if dimples is not None:
        chosen, m = np.array([int(n) - 1 for n in dimples]), len(dimples)
    rows = places[chosen].copy()
    for _ in range(20):  # where it must be measured to be truly there
        rows[:, :3] = true[chosen, :3] - error_of(rows) - offset_
    for i in range(m):  # a hand seats it a little off
        step = np.linalg.solve(
            ROBOT.kinematics.jacobian(rows[i])[:3, :3], noise * rng.standard_normal(3)
        )
        rows[i, :3] += step
    joint = np.repeat(rows, 15, axis=0)
    stamps = tuple(((15 * np.arange(m) + 14) / RATE).tolist())
    dimples = tuple(str(k + 1) for k in chosen)
    return Touched(recorded(joint, offset_, **about), Touches(stamps, dimples), block, translation)
