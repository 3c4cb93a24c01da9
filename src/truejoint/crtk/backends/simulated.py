"""The simulated back end: an arm on any digital twin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from truejoint.array_types import Array
from truejoint.crtk.arm import Arm
from truejoint.crtk.protocol import Listener
from truejoint.crtk.states import OperatingState, StateCommand, next_state
from truejoint.robots import Robot
from truejoint.robots.catalogue import DEFAULT
from truejoint.simulation import Twin, make_twin


class SimulatedBackend:
    """Executes an arm's commands on a digital twin, far faster than real time.

    Parameters
    ----------
    twin : Twin
        Kept by reference: its load may be changed while the arm works.

    Examples
    --------
    >>> SimulatedBackend(truejoint.simulation.make_twin("raven2", seed=1)).robot.name
    'raven2'
    """

    def __init__(self, twin: Twin) -> None:
        self.twin = twin
        self.robot: Final[Robot] = twin.robot
        self._state = OperatingState("DISABLED", is_homed=False, is_busy=False, t=twin.time)
        self._listener: Listener = lambda _: None

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.twin.time

    @property
    def homing_id(self) -> str:
        """Seed of the twin and number of its homing."""
        return f"seed {self.twin.seed}, homing {self.twin.homing_count}"

    def connect(self, listener: Listener) -> None:
        """Deliver all blocks from now on to `listener`, the only one."""
        self._listener = listener

    def operating_state(self) -> OperatingState:
        """State of the simulated controller."""
        return replace(self._state, t=self.twin.time)

    def state_command(self, command: StateCommand) -> None:
        """Carry out a state command; raises CommandRefused where the state forbids it."""
        after = next_state(self._state, command)
        if command == "home":
            # Positions before the registration mean nothing, so only the end pose is reported.
            self._listener(self.twin.home().rows(slice(-1, None)))
        self._state = after

    def servo_jp(self, position: Array) -> None:
        """Run the twin along set-points (n, n_joints) [rad or m] at 1 kHz."""
        output = self.twin.run(position)
        self._listener(output)
        if len(output.truth.t):
            self._listener(output.truth)

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass with the brakes on."""
        self.twin.idle(duration)


def simulated_arm(
    robot: str = DEFAULT,
    arm: str = "",
    *,
    parameters: str | Path = "nominal",
    seed: int = 0,
    load: float = 0.0,
) -> Arm:
    """Arm on a digital twin; disabled and not homed, as a robot that was just switched on.

    Parameters, and what is raised, are those of `truejoint.simulation.make_twin`. An arm on a
    twin of one's own making is ``Arm(SimulatedBackend(twin))``.

    Examples
    --------
    >>> arm = simulated_arm("forceps", seed=1)
    >>> arm.enable()
    >>> arm.home()
    >>> arm.move_jp([0.1])
    >>> print(arm.measured_js().position.round(2))
    [0.1]
    """
    return Arm(SimulatedBackend(make_twin(robot, arm, parameters=parameters, seed=seed, load=load)))
