"""A simulated RAVEN-II session for measuring the control loop: models, and samples at 1 kHz."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from truejoint.calibration import Calibration, calibrate
from truejoint.calibration.conformal import with_interval
from truejoint.crtk import Arm, StateBlock, TruthBlock, simulated_arm
from truejoint.estimators import JointRegressor
from truejoint.motion import Trajectory, follow, random_motion, zigzag
from truejoint.recordings import Recorder, Recording
from truejoint.robots.raven2 import CHANNELS

HOMING = "1"
TRAJECTORIES = 10  # for the interval: enough for 90 %


@dataclass
class Samples:
    """Samples as a loop gets them, and what the arm reported: stamps [s], rows of signals."""

    signals: tuple[str, ...]
    t: list[float]
    rows: NDArray[np.float64]


@dataclass
class Session:
    """One homing of the left arm, with recordings to train on and to make intervals of."""

    arm: Arm
    training: list[Recording]
    held_back: list[Recording]

    def fit(
        self, estimator: str | JointRegressor, quantities: Sequence[str] | None = None
    ) -> Calibration:
        """Calibration with an interval; redundant columns are of these quantities, or all."""
        redundant = quantities and [
            f"{quantity}/{joint}" for quantity in quantities for joint in CHANNELS
        ]
        model = calibrate(self.training, estimator, redundant=redundant)
        return with_interval(model, self.held_back)

    def samples(
        self, signals: tuple[str, ...], duration: float, seed: int = 7, pause: float = 0.0
    ) -> Samples:
        """Go on moving at random for `duration` [s], then hold for `pause`; take every sample."""
        stamps: list[NDArray[np.float64]] = []
        parts: list[NDArray[np.float64]] = []

        def keep(block: StateBlock | TruthBlock) -> None:
            if isinstance(block, StateBlock):
                named = (signal.split("/") for signal in signals)
                columns = [getattr(block, q)[:, block.name.index(c)] for q, c in named]
                stamps.append(block.t)
                parts.append(np.column_stack(columns))

        self.arm.subscribe(keep)
        follow(self.arm, random_motion(self.arm.robot, duration=duration, seed=seed))
        if pause > 0.0:
            self.arm.wait(pause)
        self.arm.unsubscribe(keep)
        return Samples(signals, np.concatenate(stamps).tolist(), np.concatenate(parts))


def simulated_session(seed: int = 0) -> Session:
    """Zig-zags for training, and short random motions for the interval."""
    arm = simulated_arm("raven2", "left", seed=seed)
    arm.enable()
    arm.home()

    def record(trajectory: Trajectory) -> Recording:
        with Recorder(arm, session=trajectory.name, homing_id=HOMING) as recorder:
            follow(arm, trajectory)
        return recorder.recording()

    training = [record(zigzag(arm.robot, "J1-J2-J3", 1 / n)) for n in (4, 5)]
    held_back = [
        record(random_motion(arm.robot, duration=60, seed=100 + i)) for i in range(TRAJECTORIES)
    ]
    return Session(arm, training, held_back)
