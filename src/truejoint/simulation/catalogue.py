"""Every digital twin by the name of its robot."""

from pathlib import Path
from pkgutil import resolve_name
from typing import Final

from truejoint.errors import RobotError
from truejoint.robots.catalogue import DEFAULT, get_robot
from truejoint.simulation.twin import Twin

# Imported when first asked for: each brings the compiler and its kernels.
_TWINS: Final = {
    "raven2": "truejoint.simulation.raven2.twin:Raven2Twin",
    "dvrk_psm": "truejoint.simulation.dvrk_psm.twin:DvrkPsmTwin",
    "forceps": "truejoint.simulation.forceps.twin:ForcepsTwin",
    "wrist": "truejoint.simulation.wrist.twin:WristTwin",
}


def make_twin(
    robot: str = DEFAULT,
    arm: str = "",
    *,
    parameters: str | Path = "nominal",
    seed: int = 0,
    load: float = 0.0,
) -> Twin:
    """Digital twin of a robot, as it was just switched on.

    Parameters
    ----------
    robot, arm : str
        As in `truejoint.robots.get_robot`; it is ``raven2``, ``dvrk_psm``, ``forceps``,
        ``wrist``, or one of a file that states its cables.
    parameters : str or path-like
        A specimen that comes with the package, ``"nominal"``, ``"peng2024"`` of RAVEN-II, ``"A"``
        and ``"B"`` of the forceps, ``"cable_only"`` and ``"endowrist"`` of the wrist, or a TOML
        file that states what differs from the nominal one.
    seed : int
        Seed of everything random.
    load : float
        Mass hung on the tool [kg].

    Raises
    ------
    RobotError
        If there is no such arm or no twin of it.
    TruejointError
        If the file, the seed or the load is refused.

    Examples
    --------
    >>> make_twin("forceps", seed=1).robot.joint_names
    ('jaw',)
    """
    target = get_robot(robot, arm)
    name = target.name
    if name not in _TWINS and target.mechanism is not None:
        name = "wrist"  # its twin is that of any cables
    if name not in _TWINS:
        raise RobotError(
            f"no digital twin of {target.name!r}; there is one of {', '.join(map(repr, _TWINS))}, "
            "and of a robot file that states its cables"
        )
    kind = resolve_name(_TWINS[name])
    twin: Twin = kind(kind.PARAMETERS.read(parameters), robot=target, seed=seed, load=load)
    return twin
