"""Calibration from a tracker beside the simulated RAVEN-II, against one from joint encoders.

    python -m benchmarks.tracker [--arms 3] [--runs 40] [--specimens nominal peng2024]

An arm of its own seed, freshly homed, follows zig-zags J1-J2-J3 of sparsity 1/4, 1/5 and 1/6 and
then five minutes of a random motion. Trackers of several kinds see a marker on its shaft, with a
delay, drop-outs and strays, and a state clock that is not theirs. The base is registered with
deviations of 0.2 mm and 0.03 deg, the marker with 0.1 mm, per axis, and is off by draws of that.
The same estimator learns from the joint encoders and from each tracker's truth; both are judged on
the random motion by the joint encoders. Then, in as many runs as ``--runs`` says, of five minutes
of random motion each, how often intervals of 90 % of the transforms hold. Every arm and run is kept
in a file under ``--out`` and is not run again while that is there.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import norm
from tests.simulated_tracker import TRACKERS

from benchmarks import head, parsed, row, stored
from benchmarks.arms import homed, recorded
from truejoint import calibrate
from truejoint.array_types import Array
from truejoint.crtk import StateBlock, TruthBlock, simulated_arm
from truejoint.motion import Trajectory, random_motion, zigzag
from truejoint.recordings import Recording, Track
from truejoint.simulation import TwinOutput
from truejoint.tip import Base, Marker, Registered, Registration, tracked_truth
from truejoint.units import display_unit

LINK = "roll"
DEVIATIONS = np.repeat([np.deg2rad(0.03), 2e-4, 1e-4], 3)  # turn, shift, marker
TEST_MINUTES = 5.0
LEVEL = 0.9
PARTS = {"turn of the base": slice(0, 3), "shift of the base": slice(3, 6), "marker": slice(6, 9)}


def bare(recording: Recording) -> Recording:
    """Leave the truth of a recording out."""
    units = {name: u for name, u in recording.units.items() if not name.startswith("truth")}
    return replace(recording, table=recording.table[["t", *units]], units=units)


class Session:
    """An arm on the twin, and where its joints really are."""

    def __init__(self, specimen: str, seed: int) -> None:
        self.arm = homed(simulated_arm("raven2", "left", parameters=specimen, seed=seed))
        self.robot, self.seed = self.arm.robot, seed
        self._t: list[Array] = []
        self._joint: list[Array] = []

    def _take(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, TwinOutput):
            columns = [block.name.index(name) for name in self.robot.joint_names]
            joint = block.measured[::4, columns].copy()
            joint[:, : block.joint.shape[1]] = block.joint[::4]
            self._t.append(block.t[::4])
            self._joint.append(joint)

    def record(self, paths: Sequence[Trajectory]) -> tuple[Recording, Array, Array]:
        """Record motions, and the true joints (n, 7) at stamps (n,) of the robot's clock."""
        self._t, self._joint = [], []
        self.arm.subscribe(self._take)
        recording = recorded(self.arm, *paths, session=f"seed {self.seed}")
        self.arm.unsubscribe(self._take)
        joint = np.concatenate(self._joint)
        # What motors show of a held tool is half its cable.
        tool = joint[:, 3:]
        joint[:, 3:] = tool.mean(axis=0) + 0.5 * (tool - tool.mean(axis=0))
        return recording, np.concatenate(self._t), joint


def tracked(
    kind: str, recording: Recording, t: Array, joint: Array, seed: int
) -> tuple[Recording, Registered, Array]:
    """Give the tracker's truth, and errors (9,) of its transforms in their deviations."""
    random = np.random.default_rng([seed, *kind.encode()])
    base, marker = np.eye(4), np.eye(4)
    base[:3, :3] = Rotation.random(rng=random).as_matrix()
    base[:3, 3] = random.uniform(-0.8, 0.8, 3)
    marker[:3, :3] = Rotation.random(rng=random).as_matrix()
    marker[:3, 3] = random.uniform((-0.01, -0.01, -0.03), (0.01, 0.01, 0.0))
    chain = recording.robot.kinematics.up_to(recording.robot.index([LINK])[0])
    stamps, position, turn = TRACKERS[kind].see(chain, t, joint, base, marker, seed)
    track = Track.of_readings(stamps - random.uniform(-500, 500), position, turn, kind)
    off, stated = DEVIATIONS * random.standard_normal(9), base.copy()
    stated[:3, :3] = base[:3, :3] @ Rotation.from_rotvec(off[:3]).as_matrix()
    stated[:3, 3] = base[:3, 3] + base[:3, :3] @ off[3:6]
    turn = Rotation.from_matrix(stated[:3, :3]).as_quat()
    known = Registration(
        Base(stated[:3, 3], turn, DEVIATIONS[3], DEVIATIONS[0]),
        Marker(LINK, marker[:3, 3] + off[6:], DEVIATIONS[6]),
    )
    found, registered = tracked_truth(bare(recording), track, known)
    left = np.linalg.inv(base) @ np.linalg.inv(registered.base_from_tracker)
    error = [
        Rotation.from_matrix(left[:3, :3]).as_rotvec() / registered.base_sd[:3],
        left[:3, 3] / registered.base_sd[3:],
        (registered.link_from_marker[:3, 3] - marker[:3, 3]) / registered.marker_sd,
    ]
    return found, registered, np.concatenate(error)


def one_arm(specimen: str, seed: int, estimator: str) -> dict[str, Any]:
    """RMSE (3,) and standard deviation (3,) of the error on the test, by whose truth was learnt."""
    session = Session(specimen, seed)
    training, t, joint = session.record(
        [zigzag(session.robot, "J1-J2-J3", 1 / n) for n in (4, 5, 6)]
    )
    motion = random_motion(session.robot, 60.0 * TEST_MINUTES, 1000 + seed)
    test = session.record([motion])[0].with_truth(session.robot.positioning)
    truths = {"encoders": training}
    for kind in TRACKERS:
        truths[kind] = tracked(kind, training, t, joint, seed)[0]
    result = {}
    for name, recording in truths.items():
        model = calibrate(recording, estimator, random_state=seed)
        off = model.correct(test) - test.columns("truth", model.joints)
        result[name] = [np.sqrt((off**2).mean(axis=0)).tolist(), off.std(axis=0).tolist()]
    return result


def one_run(specimen: str, seed: int, kinds: Sequence[str]) -> dict[str, Any]:
    """Errors (9,) of the transforms in their deviations, by kind of tracker, and deviations."""
    session = Session(specimen, seed)
    motion = random_motion(session.robot, 60.0 * TEST_MINUTES, seed)
    recording, t, joint = session.record([motion])
    found = {}
    for kind in kinds:
        _, registered, error = tracked(kind, recording, t, joint, seed)
        found[kind] = [error.tolist(), [*registered.base_sd, *registered.marker_sd]]
    return found


def accuracy(specimens: Sequence[str], arms: int, estimator: str, out: Path) -> None:
    """Print how far off calibrations are, beside those from joint encoders."""
    joints = ("shoulder [deg]", "elbow [deg]", "insertion [mm]")
    head("specimen", "truth", *joints, "to the encoders'", "without the mean")
    scale = np.array([display_unit(unit).scale for unit in ("rad", "rad", "m")])
    for specimen in specimens:
        found = []
        for seed in range(arms):
            make = partial(one_arm, specimen, seed, estimator)
            found.append(stored(out, f"{specimen}, arm {seed}, {estimator}", make))
        ours = np.array([arm["encoders"] for arm in found])
        for name in ("encoders", *TRACKERS):
            errors = np.array([arm[name] for arm in found])
            rms = np.sqrt((errors**2).mean(axis=0))
            both = rms / np.sqrt((ours**2).mean(axis=0))
            cells = (f"{value:.3f}" for value in rms[0] * scale)
            ratios = [
                f"{np.exp(np.log(ratio).mean()):.2f} ({', '.join(f'{r:.2f}' for r in ratio)})"
                for ratio in both
            ]
            row(specimen, name, *cells, *ratios)


def coverage(specimen: str, runs: int, kinds: Sequence[str], out: Path) -> None:
    """Print how often the transforms lie within what is stated."""
    print()
    head(f"{specimen}, {runs} runs", *PARTS, "all", "deviations")
    make = [
        stored(out, f"{specimen}, run {seed}", partial(one_run, specimen, seed, kinds))
        for seed in range(100, 100 + runs)
    ]
    limit = norm.ppf(0.5 + LEVEL / 2)
    for kind in kinds:
        errors = np.array([run[kind][0] for run in make])
        sds = np.median([run[kind][1] for run in make], axis=0)
        inside = np.abs(errors) < limit
        shares = (inside[:, rows].mean() for rows in (*PARTS.values(), slice(None)))
        shown = f"{np.rad2deg(sds[:3].mean()):.3f} deg, {1e3 * sds[3:6].mean():.3f} mm"
        row(kind, *(f"{100 * share:.0f} %" for share in shares), shown)


def main() -> None:
    """Print the tables."""
    options = parsed(
        __doc__, specimens=["nominal", "peng2024"], arms=3, runs=40, estimator="dnn",
        kinds=["optical", "optical_pose", "rgbd"], out=Path("bench/tracker"),
    )  # fmt: skip
    if options.arms:
        accuracy(options.specimens, options.arms, options.estimator, options.out)
    for specimen in options.specimens:
        if options.runs:
            coverage(specimen, options.runs, options.kinds, options.out)


if __name__ == "__main__":
    main()
