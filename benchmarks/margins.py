"""How far a compensator's gain, integral and delay may be from its own until it does harm.

    python -m benchmarks.margins [--seconds 60] [--seed 0]

A linear model of five minutes of random motion is in the loop around the simulated RAVEN-II like
that of peng2024, which then moves at random anew in the same homing. One thing at a time is
changed: the gain, which is 0 by default, the integral by a factor, and by how much samples come
late. Prints a Markdown table: RMS of where joints are wanted less where only the twin knows they
are, as a share of what the same motion without compensation leaves but for its mean, which a fixed
offset would take off; the share of the loop's steps that were OK; and what ended the motion.
"""

import logging
from collections import Counter, deque
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmarks import head, parsed, row
from benchmarks.arms import blocks_of, homed, recorded
from truejoint.array_types import Array
from truejoint.calibration import calibrate
from truejoint.crtk import Arm, simulated_arm
from truejoint.errors import CommandRefused
from truejoint.motion import Trajectory, random_motion
from truejoint.runtime import Compensator, Corrector, Status
from truejoint.simulation import TwinOutput

TRAINING = 300.0  # [s]
INTEGRAL_TIME = 0.5  # of a compensator by default [s]
CASES = (
    ("as it is by default", {}),
    *((f"gain {gain:g}", {"gain": gain}) for gain in (0.5, 1.0, 2.0, 5.0)),
    *((f"integral x {x:g}", {"integral_time": INTEGRAL_TIME / x}) for x in (2.0, 5.0, 10.0, 20.0)),
    *((f"samples {1e3 * s:.0f} ms late", {"delay": s}) for s in (0.02, 0.05, 0.1)),
    *(
        (f"integral x {x:g}, 100 ms late", {"integral_time": INTEGRAL_TIME / x, "delay": 0.1})
        for x in (2.0, 5.0)
    ),
)


class Late(Compensator):
    """A compensator with any gain, whose samples come `delay` [s] late."""

    def __init__(self, *given: Any, delay: float = 0.0, gain: float = 0.0, **how: Any) -> None:
        super().__init__(*given, **how)
        self.gain = gain  # one that the constructor would refuse, too
        self._samples: deque[tuple[float, ArrayLike]] = deque(maxlen=1 + round(delay * self.rate))

    def step(self, t: float, sample: ArrayLike, wanted: ArrayLike) -> Array:
        """Step with an older sample."""
        self._samples.append((t, sample))
        return super().step(*self._samples[0], wanted)


def new_arm(seed: int) -> Arm:
    """Give the arm, homed as all of the same seed."""
    return homed(simulated_arm("raven2", "left", parameters="peng2024", seed=seed))


def errors(arm: Arm, path: Trajectory, loop: Compensator | None) -> tuple[Array, str]:
    """Errors of the joints along a motion (n, n_joints) [rad or m], and what ended it early."""
    assert path.times is not None  # noqa: S101
    times = np.arange(0.0, path.times[-1], 1.0 / arm.rate)
    wanted = np.column_stack([np.interp(times, path.times, joint) for joint in path.positions.T])
    full = np.tile(arm.setpoint_js(np.inf).position, (len(wanted), 1))
    full[:, arm.robot.index(path.joints)] = wanted
    true: list[TwinOutput] = []
    ended, on_the_way = "", False
    try:
        if loop is None:
            arm.move_jp(full[0]).wait()
        else:
            loop.approach(arm, full[0])
            loop.statuses.clear()
        on_the_way = True
        with blocks_of(arm, TwinOutput) as true:
            arm.servo_jp_stream(full) if loop is None else loop.drive(arm, wanted)
    except CommandRefused as refusal:
        seconds = sum(len(block.joint) for block in true) / arm.rate
        at, why = f"after {seconds:.0f} s" if on_the_way else "on the way to it", str(refusal)
        if loop is not None and loop.trouble:
            doubted = loop.statuses - Counter({Status.OK: loop.statuses[Status.OK]})
            why = f"fell back, most seen {doubted.most_common(1)[0][0].name}"
        ended = f"{at}: {why}"
    if not true:
        return np.full((1, wanted.shape[1]), np.nan), ended
    # The loop waits for a sample first.
    joint = np.concatenate([block.joint for block in true])[loop is not None :]
    return joint[: len(wanted)] - wanted[: len(joint)], ended


def main() -> None:
    """Print the table."""
    options = parsed(__doc__, seconds=60.0, seed=0)
    logging.disable(logging.WARNING)  # what it says on the way
    arm = new_arm(options.seed)
    training = random_motion(arm.robot, TRAINING, seed=1)
    learnt = recorded(arm, training, session="training", homing_id="1")
    model = calibrate([learnt], "linear").without_redundant()
    arm = new_arm(options.seed)
    path = random_motion(arm.robot, options.seconds, seed=2)
    without = errors(arm, path, None)[0].std(axis=0)
    head("loop", *path.joints, "steps OK", "ended by")
    row("none, a fixed offset", *["100 %"] * len(without), "", "")
    for title, how in CASES:
        arm, corrector = new_arm(options.seed), Corrector(model)
        corrector.set_homing(True, "1")
        loop = Late(corrector, arm.robot, **how)
        error, ended = errors(arm, path, loop)
        rms = 100.0 * np.sqrt(np.mean(error**2, axis=0)) / without
        shares = ("-" if np.isnan(share) else f"{share:.0f} %" for share in rms)
        ok = 100.0 * loop.statuses[Status.OK] / max(loop.statuses.total(), 1)
        row(title, *shares, f"{ok:.0f} %", ended)


if __name__ == "__main__":
    main()
