"""`Raven2Twin`: a virtual RAVEN-II arm that errs the way the real one does, and its parameters."""

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, NamedTuple

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.robots.raven2 import hardware
from truejoint.robots.raven2.hardware import HOMING_RAMP, HOMING_RETURN, HOMING_SETTLE
from truejoint.schema import Bounds
from truejoint.simulation.arm import kernel
from truejoint.simulation.arm.parameters import ArmParameters, Numbers
from truejoint.simulation.arm.plant import Hardware, gravity_potential
from truejoint.simulation.arm.twin import ArmTwin
from truejoint.simulation.twin import TwinOutput, glide, hold

POSITIONING: Final = 3
# The insertion needs 17 s from its far end, the others less.
_SEARCH_LIMIT: Final = 25.0  # s
_SEARCH_PIECE: Final = 500  # rows


class Pulleys(NamedTuple):
    """Real against nominal transmission: scale, coupling and run-out."""

    scale: Annotated[Numbers, Bounds(-0.2, 0.2)]
    coupling_shoulder_elbow: Annotated[float, Bounds(-0.3, 0.3)]
    coupling_shoulder_insertion: Annotated[float, Bounds(-0.02, 0.02)]
    coupling_elbow_insertion: Annotated[float, Bounds(-0.02, 0.02)]
    capstan_run_out: Annotated[Numbers, Bounds(0.0, 1e-3)]
    capstan_phase: Annotated[Numbers, Bounds(-7.0, 7.0)]
    joint_run_out: Annotated[Numbers, Bounds(0.0, 2e-3)]
    joint_phase: Annotated[Numbers, Bounds(-7.0, 7.0)]


class Wrap(NamedTuple):
    """Change of cable length where runs leave their pulleys at an angle."""

    free_run: Annotated[Numbers, Bounds(0.01, 2.0)]
    sideways_shoulder: Annotated[Numbers, Bounds(-0.05, 0.05)]
    sideways_elbow: Annotated[Numbers, Bounds(-0.05, 0.05)]
    sideways_insertion: Annotated[Numbers, Bounds(-0.5, 0.5)]
    aligned: Annotated[Numbers, Bounds(-3.2, 3.2)]


class Mass(NamedTuple):
    """Mass [kg] that the robot's own link masses leave out."""

    instrument: Annotated[float, Bounds(0.0, 2.0)]


class Homing(NamedTuple):
    """How registration at the hard stops errs."""

    registration_sd: Annotated[Numbers, Bounds(0.0, 0.1)]
    registration_bias: Annotated[Numbers, Bounds(-0.1, 0.1)]


@dataclass(frozen=True)
class Raven2Parameters(ArmParameters):
    """Everything that makes the twin of a RAVEN-II arm err; one attribute per section."""

    SPECIMENS: ClassVar[tuple[str, ...]] = "nominal", "peng2024"

    pulleys: Pulleys
    wrap: Wrap
    mass: Mass
    homing: Homing


class Raven2Twin(ArmTwin):
    """Digital twin of one RAVEN-II arm; a `truejoint.simulation.Twin`.

    State arrays have one column per channel of the robot's state message (shoulder, elbow,
    insertion, unused, roll, wrist, jaw1, jaw2).
    """

    ROBOT: ClassVar[str] = "raven2"
    PARAMETERS: ClassVar[type[Raven2Parameters]] = Raven2Parameters
    MAX_LOAD: ClassVar[float] = 2.0  # the shoulder's motor gives up a little above

    parameters: Raven2Parameters

    def _hardware(self) -> Hardware:
        p, robot = self.parameters, self.robot
        drives = self._drives = hardware.drives(robot.arm)
        motor_stop = np.array([drive.hard_stop for drive in drives[:POSITIONING]])
        self._nominal_stop = np.concatenate([motor_stop, robot.home[POSITIONING:]])
        assert robot.transmission is not None  # noqa: S101 - for the type checker; RAVEN-II has one
        coupling_error = np.zeros((3, 3))
        below = np.tril_indices(3, -1)  # shoulder-elbow, shoulder- and elbow-insertion
        coupling_error[below] = [
            p.pulleys.coupling_shoulder_elbow,
            p.pulleys.coupling_shoulder_insertion,
            p.pulleys.coupling_elbow_insertion,
        ]
        truth_stop = np.array([encoder.hard_stop for encoder in robot.encoders])
        # One stop is where homing looks for it, the other 5 % beyond the soft limit.
        margin = 0.05 * (robot.upper - robot.lower)
        stops = np.column_stack([robot.lower - margin, robot.upper + margin])[:3]
        stops[0, 0], stops[1:, 1] = truth_stop[0], truth_stop[1:]
        mass, centre = hardware.links(robot.arm)
        # The carriage holds the instrument, whose weight the published link leaves out.
        mass[2] += p.mass.instrument
        return Hardware(
            matrix=robot.transmission.matrix,
            ratio=np.array([drive.transmission_ratio for drive in drives]),
            gear=np.array([drive.gear_ratio for drive in drives]),
            radius=np.array([drive.capstan_radius for drive in drives[:POSITIONING]]),
            gains=np.array([[drive.kp, drive.kd, drive.ki] for drive in drives]),
            effort_limit=np.array([drive.max_effort for drive in drives]),
            effort_step=np.array([drive.torque_per_amp / drive.dac_per_amp for drive in drives]),
            counts=np.full(7, float(hardware.ENCODER_COUNTS_PER_REV)),
            coupling_error=coupling_error,
            scale=np.array(p.pulleys.scale),
            anchor=(motor_stop, truth_stop),
            stops=stops,
            run_out=(
                (np.array(p.pulleys.capstan_run_out), np.array(p.pulleys.capstan_phase)),
                (np.array(p.pulleys.joint_run_out), np.array(p.pulleys.joint_phase)),
            ),
            sideways=np.column_stack(
                [p.wrap.sideways_shoulder, p.wrap.sideways_elbow, p.wrap.sideways_insertion]
            ),
            aligned=np.array(p.wrap.aligned),
            free_run=np.array(p.wrap.free_run),
            gravity=gravity_potential(robot, mass, centre, hardware.GRAVITY),
            truth_step=np.array([encoder.resolution for encoder in robot.encoders]),
        )

    def homing(self) -> Generator[TwinOutput]:
        """Find the hard stops, register both kinds of encoder there, go to the home pose.

        As uw-biorobotics/raven2:src/raven/homing.cpp does it: each positioning joint moves
        towards its stop until its torque command says that it has arrived; after 0.2 s its
        motor encoder is set to the stop's nominal position, and all return within 2.5 s. The tool's
        joints are held where their own homing leaves them, near home. Rows before the
        registration are meaningless, as on the robot.
        """
        yield from self._search_stops()
        # The motor encoders' zeros are set, the arm standing at its hard stops.
        homing = self.parameters.homing
        wrong = self._nominal_stop.copy()
        wrong[:POSITIONING] += np.array(homing.registration_bias) + np.array(
            homing.registration_sd
        ) * self._rng.standard_normal(POSITIONING)
        self._register(wrong)
        # The robot restarts its set point at the nominal stop.
        self._state.command[:] = self._plant.motor_from_joint @ self._nominal_stop
        home = self.robot.home
        yield from self._go(glide(self._nominal_stop, home, HOMING_RETURN), hold(home, 1.0))

    def _search_stops(self) -> Iterator[TwinOutput]:
        """Move to the hard stops and settle there; the encoders are not touched."""
        start = self._take_up()
        limits = [drive.homing_effort for drive in self._drives[:POSITIONING]]
        speed = np.array([drive.homing_speed for drive in self._drives[:POSITIONING]])
        steps = round(_SEARCH_LIMIT / kernel.DT)
        stop_row = np.full(POSITIONING, steps)
        # The speed builds up along a quarter of a sine within HOMING_RAMP.
        t = np.arange(1, steps + _SEARCH_PIECE + 1) * kernel.DT
        slow = (1.0 - np.cos(np.pi / HOMING_RAMP * np.minimum(t, HOMING_RAMP) / 2)) * (
            2.0 * HOMING_RAMP / np.pi
        )
        travelled = slow + np.maximum(0.0, t - HOMING_RAMP)

        def path(first: int, last: int) -> Array:
            """Set-points of rows towards the stops, each joint held from `stop_row` on."""
            rows = np.tile(start, (last - first, 1))
            way = travelled[np.minimum(np.arange(first, last)[:, None], stop_row)]
            rows[:, :POSITIONING] += speed * way
            return rows

        done = 0
        while (stop_row == steps).any() and done < steps:
            # A joint that stands at its stop loads the others through the cables: a piece of time
            # is tried, and run again with a joint held from where it arrives.
            back = self.saved()
            piece = path(done, min(done + _SEARCH_PIECE, steps))
            output = self._follow(piece)
            above = (np.abs(output.effort[:, :POSITIONING]) >= limits) & (stop_row == steps)
            after = self._stamp_rng.bit_generator.state
            back()
            if above.any():
                row = int(np.argmax(above.any(axis=1)))
                stop_row[np.argmax(above[row])] = done + row
                self._stamp_rng.bit_generator.state = after
            else:
                yield from self._go(piece)
                done += len(piece)
        if (stop_row == steps).any():
            names = [self.robot.joint_names[k] for k in range(POSITIONING) if stop_row[k] == steps]
            raise TruejointError(
                f"homing found no hard stop for {', '.join(names)} within {_SEARCH_LIMIT:g} s; "
                "the parameters make friction too strong for the motor"
            )
        last = int(stop_row.max()) + round(HOMING_SETTLE / kernel.DT)
        yield from self._go(path(done, last))
