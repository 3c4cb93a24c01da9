"""The simulated back end: an arm on RAVEN-II's digital twin."""

from __future__ import annotations

from dataclasses import replace

from truejoint.crtk.arm import Arm
from truejoint.crtk.backend import Listener
from truejoint.crtk.messages import Array, OperatingState, StateBlock, TruthBlock
from truejoint.crtk.states import StateCommand, next_state
from truejoint.errors import RobotError
from truejoint.robots import Robot, get_robot
from truejoint.simulation import Raven2Twin, TwinOutput, TwinParameters


class SimulatedBackend:
    """Executes an arm's commands on a digital twin, far faster than real time.

    Parameters
    ----------
    twin : Raven2Twin
        Kept by reference: its load may be changed while the arm works.

    Examples
    --------
    >>> SimulatedBackend(truejoint.simulation.Raven2Twin()).robot.name
    'raven2'
    """

    def __init__(self, twin: Raven2Twin) -> None:
        self.twin = twin
        self._state = OperatingState("DISABLED", is_homed=False, is_busy=False, t=twin.time)
        self._listener: Listener | None = None

    @property
    def robot(self) -> Robot:
        """The arm behind."""
        return self.twin.robot

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.twin.time

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
            self._deliver(self.twin.home(), last_only=True)
        self._state = after

    def servo_jp(self, position: Array) -> None:
        """Run the twin along set-points (n, n_joints) [rad or m] at 1 kHz."""
        self._deliver(self.twin.run(position))

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass with the brakes on."""
        self.twin.idle(duration)

    def _deliver(self, output: TwinOutput, *, last_only: bool = False) -> None:
        if self._listener is None:
            return
        rows = slice(-1 if last_only else 0, None)
        self._listener(
            StateBlock(
                t=output.t[rows],
                name=self.robot.channels,
                measured=output.measured[rows],
                velocity=output.velocity[rows],
                effort=output.effort[rows],
                setpoint=output.setpoint[rows],
                motor=output.motor[rows],
                motor_velocity=output.motor_velocity[rows],
            )
        )
        if len(output.truth_t) and not last_only:
            self._listener(TruthBlock(output.truth_t, self.robot.positioning, output.truth))


def simulated_arm(
    robot: str = "raven2",
    arm: str = "",
    *,
    parameters: TwinParameters | None = None,
    seed: int = 0,
    load: float = 0.0,
) -> Arm:
    """Arm on a digital twin; disabled and not homed, as a robot that was just switched on.

    Parameters
    ----------
    robot : str
        A robot that has a twin: ``"raven2"``.
    arm : str
        As in `truejoint.robots.get_robot`: ``"left"`` or ``"right"``; the left by default.
    parameters : TwinParameters, optional
        Physics of the twin; the shipped ones by default.
    seed : int
        Of everything random in the twin.
    load : float
        Mass hung on the tool [kg].

    Raises
    ------
    RobotError
        If the robot has no twin.

    Examples
    --------
    >>> simulated_arm("raven2", "left", seed=1).operating_state().state
    'DISABLED'
    """
    if robot.lower() != "raven2":
        raise RobotError(f"no digital twin of {robot!r}; there is one of 'raven2'")
    side = get_robot("raven2", arm).arm
    return Arm(SimulatedBackend(Raven2Twin(parameters, arm=side, seed=seed, load=load)))
