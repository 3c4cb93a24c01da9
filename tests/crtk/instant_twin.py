"""A twin that homes at once and is where it is told to be."""

import threading

import numpy as np

from truejoint.robots import get_robot
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.simulation import TwinOutput


def hear(arm, count):
    """State messages that an arm reports, one after the other, from now on."""
    blocks, enough = [], threading.Event()

    def keep(block):
        if isinstance(block, StateBlock):
            blocks.append(block)
            if len(blocks) == count:
                enough.set()

    arm.subscribe(keep)
    assert enough.wait(60.0)
    arm.unsubscribe(keep)
    return blocks[:count]


class InstantTwin:
    """Sensors and joints are all where the set-point is; efforts are 0.1 Nm."""

    def __init__(self):
        self.robot, self.seed, self.load, self.homing_count = get_robot("raven2"), 0, 0.0, 0
        self.ticks, self.rows = 0, []

    @property
    def time(self):
        return self.ticks * 1e-3

    def homing(self):
        self.homing_count += 1
        yield self.run(self.robot.home[None])

    def run(self, setpoint):
        rows = np.asarray(setpoint, dtype=float)
        self.rows.append(rows)
        t = self.time + 1e-3 * np.arange(1, len(rows) + 1)
        self.ticks += len(rows)
        full = np.insert(rows, 3, 0.0, axis=1)
        still = np.zeros_like(full)
        effort = np.insert(np.full_like(rows, 0.1), 3, 0.0, axis=1)
        truth = TruthBlock(t[:0], self.robot.positioning, rows[:0, :3])
        return TwinOutput(
            t=t, name=self.robot.channels, measured=full, velocity=still, effort=effort,
            setpoint=full, motor=still, motor_velocity=still, truth=truth, joint=rows[:, :3],
        )  # fmt: skip

    def home(self):
        return TwinOutput.joined(list(self.homing()))

    def idle(self, duration):
        self.ticks += round(duration * 1e3)
