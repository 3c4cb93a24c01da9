"""Joints that several cables turn, pulling on each other: motors, cables, contact, arms as data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields
from typing import Any, Final, TypeVar

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import RobotError, unknown
from truejoint.robots.plain import check_keys

MAX_CABLES: Final = 64
_SAME: Final = 1e-9  # [m] between the moments of two cables of one motor
_Made = TypeVar("_Made")


@dataclass(frozen=True)
class Pin:
    """What a joint turns on: inertia [kg m2] of what turns, radius [m], constant friction [Nm]."""

    inertia: float
    radius: float
    friction: float = 0.0


@dataclass(frozen=True)
class Node:
    """Where a cable bends: wrap angle [rad] in the pose of zeros.

    A `joint` that is named turns the cable's path with it: its angle shortens the wrap of cables
    whose moment about it is positive and lengthens that of those whose moment is negative.
    """

    wrap: float
    joint: str = ""


@dataclass(frozen=True)
class Cable:
    """One cable, from its end at a motor's capstan, or a spring, to the link that it pulls.

    Attributes
    ----------
    name : str
    moments : mapping of str to float
        By how much each joint's angle lets the cable's end go [m/rad].
    motor : str
        Whose capstan winds it up; empty if it ends at a spring.
    sign : int
        1 or -1: which way the motor turns to wind it up.
    spring : float
        Stiffness [N/m] of the spring at its end; 0 if it ends at a motor.
    segments : tuple of float
        Shares of the cable's compliance before, between and behind its nodes; their sum is 1.
    nodes : tuple of Node
        From the motor on, one fewer than the segments.
    """

    name: str
    moments: Mapping[str, float]
    motor: str = ""
    sign: int = 1
    spring: float = 0.0
    segments: tuple[float, ...] = (1.0,)
    nodes: tuple[Node, ...] = ()


@dataclass(frozen=True)
class Contact:
    """Jaws that meet: opening = sum of `opening[joint]` x angle; stiffness and damping [Nm ...]."""

    opening: Mapping[str, float]
    stiffness: float = 1.5
    damping: float = 2e-3


@dataclass(frozen=True, eq=False, repr=False)
class CableMechanism:
    """Joints, motors and the cables between them; everything in SI.

    Attributes
    ----------
    pins : mapping of str to Pin
        By joint, in the order of every joint vector.
    motors : mapping of str to float
        Radius [m] of each motor's capstan, in the order of every motor vector.
    cables : tuple of Cable
    contact : Contact, optional
        Of two jaws; None where nothing meets.
    arms : mapping of str to mapping
        By the name of a force at the tip, the moment arm [m] about each joint that it turns.

    Raises
    ------
    RobotError
        If a cable ends nowhere, a name is not one of the joints or motors, a number breaks its
        rule, or the coupling cannot be inverted.

    Examples
    --------
    >>> mechanism = truejoint.get_robot("wrist").cable_mechanism
    >>> mechanism.joint_names, len(mechanism.cables)
    (('pitch', 'jaw1', 'jaw2'), 6)
    """

    pins: Mapping[str, Pin]
    motors: Mapping[str, float]
    cables: tuple[Cable, ...]
    contact: Contact | None = None
    arms: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        """One line, as it stands among an estimator's settings; `vars` has the rest."""
        turned = ", ".join(self.joint_names)
        return f"<{turned} by {len(self.motors)} motors and {len(self.cables)} cables>"

    def __post_init__(self) -> None:
        for joint, pin in self.pins.items():
            for key, value in vars(pin).items():
                _check_number(value, key != "friction", f"joint {joint!r}: {key}")
        for motor, radius in self.motors.items():
            _check_number(radius, True, f"motor {motor!r}: radius")
        if not 0 < len(self.cables) <= MAX_CABLES:
            raise RobotError(f"{len(self.cables)} cables; want 1 to {MAX_CABLES}")
        names = [cable.name for cable in self.cables]
        for cable in self.cables:
            if names.count(cable.name) > 1:
                raise RobotError(f"cable {cable.name!r} stands twice; keep one")
            self._check_cable(cable)
        if self.contact is not None:
            self._check_joints(self.contact.opening, "contact")
            _check_number(self.contact.stiffness, True, "contact: stiffness")
            _check_number(self.contact.damping, False, "contact: damping")
        for name, arm in self.arms.items():
            self._check_joints(arm, f"arm {name!r}")
        matrix = self.coupling
        if len(matrix) != len(self.pins) or np.linalg.matrix_rank(matrix) < len(matrix):
            raise RobotError(
                f"the coupling of {len(self.motors)} motors to {len(self.pins)} joints cannot be "
                "inverted; each joint needs a motor of its own, and cables that turn it"
            )

    def _check_cable(self, cable: Cable) -> None:
        where = f"cable {cable.name!r:.40}"
        _check_values(cable, where)
        if bool(cable.motor) == (cable.spring > 0.0):
            raise RobotError(
                f"{where} ends nowhere; give it a motor, or a spring [N/m]"
                if not cable.motor
                else f"{where} ends at a motor and at a spring; keep one"
            )
        if cable.motor and cable.motor not in self.motors:
            raise RobotError(f"{where}: {unknown('motor', cable.motor, self.motors)}")
        if cable.sign not in (1, -1):
            raise RobotError(f"{where}: sign is {cable.sign!r:.40}; want 1 or -1")
        self._check_joints(cable.moments, where)
        if not any(cable.moments.values()):
            raise RobotError(f"{where} ends nowhere: it turns no joint; give it a moment [m]")
        if len(cable.nodes) != len(cable.segments) - 1:
            raise RobotError(
                f"{where}: {len(cable.segments)} segments and {len(cable.nodes)} nodes; want one "
                "segment more than nodes"
            )
        whole = math.fsum(cable.segments)
        if abs(whole - 1.0) > 1e-6:
            raise RobotError(f"{where}: segments add up to {whole:g}; want shares of 1")
        self._check_joints({node.joint: 0.0 for node in cable.nodes if node.joint}, where)

    def _check_joints(self, by_joint: Mapping[str, float], where: str) -> None:
        for joint, value in by_joint.items():
            if joint not in self.pins:
                raise RobotError(f"{where}: {unknown('joint', joint, self.pins)}")
            if not math.isfinite(value):
                raise RobotError(f"{where}: {joint} is {value!r:.40}; want a finite number")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(self.pins)

    @property
    def moments(self) -> Array:
        """Moment of each cable about each joint (n_cables, n_joints) [m]."""
        return np.array([self.row(cable.moments) for cable in self.cables])

    def row(self, by_joint: Mapping[str, float]) -> Array:
        """Numbers by joint as a vector (n_joints,), 0 where there is none."""
        return np.array([float(by_joint.get(joint, 0.0)) for joint in self.pins])

    @property
    def coupling(self) -> Array:
        """Motor angle per joint angle (n_motors, n_joints) [rad/rad] where no cable gives way.

        Raises RobotError if a motor winds up no cable, or its cables ask for different angles.
        """
        rows = []
        for motor, radius in self.motors.items():
            own = [c.sign * self.row(c.moments) for c in self.cables if c.motor == motor]
            if not own:
                raise RobotError(f"motor {motor!r} winds up no cable; give it one")
            if any(np.abs(other - own[0]).max() > _SAME for other in own):
                raise RobotError(
                    f"the cables of motor {motor!r} have different moments; what one gets the "
                    "other must give"
                )
            rows.append(own[0] / radius)
        return np.array(rows)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> CableMechanism:
        """Mechanism of plain values, as `to_dict` gives or ``[cable_mechanism]`` of a file has.

        Raises RobotError, naming the key and the rule that it breaks.
        """
        known = ("pins", "motors", "cables", "contact", "arms")
        check_keys(values, known, known[:3], "cable_mechanism")
        pins = {
            name: _made(Pin, row, f"pin {name!r}")
            for name, row in _by_name(values["pins"], "pins").items()
        }
        contact = values.get("contact")
        if isinstance(contact, Mapping) and "opening" in contact:
            contact = {**contact, "opening": _numbers(contact["opening"], "contact: opening")}
        return cls(
            pins,
            {
                name: row["radius"] if isinstance(row, Mapping) and "radius" in row else row
                for name, row in _by_name(values["motors"], "motors").items()
            },
            tuple(_cable(row, n) for n, row in enumerate(_list(values["cables"], "cables"), 1)),
            None if contact is None else _made(Contact, contact, "contact"),
            {
                name: _numbers(row, name)
                for name, row in _by_name(values.get("arms", {}), "arms").items()
            },
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI; lists where the order counts, which keys of JSON may lose."""
        plain: dict[str, Any] = {
            "pins": [{"name": name, **asdict(pin)} for name, pin in self.pins.items()],
            "motors": [{"name": name, "radius": radius} for name, radius in self.motors.items()],
            "cables": [
                {
                    **asdict(cable),
                    "moments": dict(cable.moments),
                    "segments": list(cable.segments),
                    "nodes": [asdict(node) for node in cable.nodes],
                }
                for cable in self.cables
            ],
            "arms": [{"name": name, **arm} for name, arm in self.arms.items()],
        }
        if self.contact is not None:
            plain["contact"] = {**asdict(self.contact), "opening": dict(self.contact.opening)}
        return plain


def loops(
    coupling: Array, joints: Sequence[str], radii: Mapping[str, float], **path: Any
) -> tuple[Cable, ...]:
    """Two cables for each motor, one that it winds up as it lets the other go.

    Parameters
    ----------
    coupling : ndarray, shape (n_motors, n_joints)
        Motor angle per joint angle [rad/rad].
    joints : sequence of str
        In the order of its columns.
    radii : mapping of str to float
        Radius of each motor's capstan [m].
    **path
        Segments and nodes of every cable.
    """
    moments = coupling * np.array(list(radii.values()))[:, None]
    return tuple(
        Cable(
            f"{motor}_{end}",
            {j: sign * float(m) for j, m in zip(joints, row, strict=True) if m},
            motor,
            sign,
            **path,
        )
        for motor, row in zip(radii, moments, strict=True)
        for end, sign in (("a", 1), ("b", -1))
    )


def _cable(values: Any, number: int) -> Cable:
    where = f"cable {number}"
    row = dict(_table(values, where))
    row["moments"] = _numbers(row.get("moments", {}), where)
    row["segments"] = tuple(_list(row.get("segments", (1.0,)), f"{where}: segments"))
    nodes = _list(row.get("nodes", ()), f"{where}: nodes")
    row["nodes"] = tuple(_made(Node, node, f"{where}: node") for node in nodes)
    return _made(Cable, row, where)


def _made(kind: type[_Made], values: Any, where: str) -> _Made:
    """Make a value of a table that states its fields."""
    table = _table(values, where)
    own = fields(kind)  # type: ignore[arg-type]
    needed = [f.name for f in own if f.default is MISSING and f.default_factory is MISSING]
    check_keys(table, [f.name for f in own], needed, where)
    return kind(**table)


def _check_values(cable: Cable, where: str) -> None:
    """Refuse what is no text or number where one is needed."""
    for text in (cable.name, cable.motor, *(node.joint for node in cable.nodes)):
        if not isinstance(text, str):
            raise RobotError(f"{where}: {text!r:.40} is no name; write it in quotes")
    _check_number(cable.spring, False, f"{where}: spring")
    for share in cable.segments:
        _check_number(share, True, f"{where}: segment")
    for node in cable.nodes:
        _check_number(node.wrap, False, f"{where}: wrap")


def _list(values: Any, where: str) -> Sequence[Any]:
    if not isinstance(values, list | tuple):
        raise RobotError(f"{where}: {values!r:.40} is no list; write it in brackets")
    return values


def _table(values: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(values, Mapping):
        raise RobotError(f"{where} is {values!r:.40}; want a table")
    return values


def _by_name(values: Any, where: str) -> Mapping[str, Any]:
    """Read tables by name, which may also stand in a list, each with its name."""
    if not isinstance(values, list | tuple):
        return _table(values, where)
    rows = [dict(_table(row, where)) for row in values]
    found = {str(row.pop("name", "")): row for row in rows}
    if len(found) < len(rows) or "" in found:
        raise RobotError(f"{where}: want a table each, with a name of its own")
    return found


def _numbers(values: Any, where: str) -> dict[str, float]:
    table = _table(values, where)
    for name, value in table.items():
        _check_number(value, None, f"{where}: {name}")
    return {name: float(value) for name, value in table.items()}


def _check_number(value: Any, above: bool | None, where: str) -> None:
    """Refuse what is no finite number, is not above 0, or (`above` is False) is below it."""
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not good or (above and value <= 0.0) or (above is False and value < 0.0):
        rule = {True: " above 0", False: ", 0 or more", None: ""}[above]
        raise RobotError(f"{where} is {value!r:.40}; want a finite number{rule}, in SI units")
