"""Specimens of the forceps, and recordings of them in the shape that a laboratory's would have."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.estimators.jaw.signals import MOTOR, RESET
from truejoint.features.feature_set import time_steps
from truejoint.motion import Trajectory, nested_motion
from truejoint.motion import forceps_trajectories as paths
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.simulation.forceps.load import LoadTest, SwingingLoad
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.twin import ZeroShift, simulate_forceps
from truejoint.studies.study import Settings

Plain = Mapping[str, Mapping[str, Any]]
"""A specimen as plain values, which `Part.arguments` can hold."""

_TONES: Final = paths.CALIBRATION_TONES
_TRAJECTORIES: Final[Mapping[str, Callable[[], Trajectory]]] = {
    "calibration": paths.calibration_trajectory,
    "verification": paths.verification_trajectory,
    "nested": lambda: nested_motion(get_robot("forceps"), rate=1000.0),
    "cycle": lambda: paths.sine_trajectory(_TONES, 2.0 * math.pi / _TONES[0][1]),
}


def tensioned(plant: ForcepsParameters, factor: float) -> ForcepsParameters:
    """Specimen whose cables are `factor` times as tense: the same ropes, as stiff as that makes.

    A rope's stiffness grows with its tension along one line, of which `Cable` states the slope at
    the pretension. Raises TruejointError where a specimen cannot be that tense.
    """
    values: dict[str, Any] = {"assembly.pretension": factor * plant.assembly.pretension}
    for name in ("drive_cable", "reset_cable"):
        cable = getattr(plant, name)
        growth = 1.0 + cable.stiffening * (factor - 1.0)
        values[f"{name}.stiffness"] = growth * cable.stiffness
        values[f"{name}.stiffening"] = factor / growth * cable.stiffening
    return plant.with_values(values)


def trajectory(name: str) -> Trajectory:
    """Trajectory of a motion; raises TruejointError for a name that is none."""
    if name not in _TRAJECTORIES:
        names = ", ".join(_TRAJECTORIES)
        raise TruejointError(f"no motion {name!r:.60}; choose one of {names}, or a load test")
    return _TRAJECTORIES[name]()


def drawn_specimens(settings: Settings) -> list[tuple[str, Plain, int]]:
    """Specimens that a study is made on, each with a name and a seed of its own.

    The one named by the option ``specimen``, or as many of a population as ``count`` says.
    """
    if not settings["count"]:
        name = settings["specimen"]
        plain = ForcepsParameters.read(name).to_dict()
        return [(f"specimen-{Path(name).stem}", plain, settings.seed)]
    plants = population(settings["count"], settings.seed, settings["prior"])
    return [(f"specimen-{n:05d}", plant.to_dict(), n) for n, plant in enumerate(plants)]


def load_test(mass: float, direction: str, *, quick: bool = False, **how: float) -> LoadTest:
    """Load test of a weight [kg]; raises TruejointError for one that cannot be.

    A `quick` one turns at twice the paper's speed and waits less.
    """
    brief = {"speed": math.radians(3.75), "start": 1.0, "loaded_from": 10.0, "loaded_to": 12.5}
    return LoadTest(mass, cast("Any", direction), **(brief | how if quick else how))


def changed(recording: Recording, name: str, values: ArrayLike) -> Recording:
    """Put another column `name` (n,) into a recording."""
    table = recording.table.assign(**{name: np.asarray(values, dtype=np.float64)})
    return Recording(table, recording.units, recording.provenance)


def signals(recording: Recording, *names: str) -> tuple[Array, Array]:
    """Columns (n, k), motor angle and ``x2`` by default, and time since the row before (n,) [s]."""
    X = np.column_stack([recording.column(name) for name in names or (MOTOR, RESET)])
    return X, time_steps(recording.t, np.inf)


def record_forceps(
    parameters: ForcepsParameters,
    motion: str | ArrayLike | LoadTest,
    *,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift = ZeroShift(),  # noqa: B008  # frozen
    load: SwingingLoad = SwingingLoad(0.0),  # noqa: B008  # frozen
) -> Recording:
    """Record a motion of the virtual forceps: what a laboratory would have of it, and its truth.

    The motion is one of the paper, ``"calibration"``, (27), ``"verification"``, (28), ``"cycle"``,
    a period of (27), or the load test of IV-D; or ``"nested"``, our own `nested_motion`; or angles.
    Other arguments, and what is raised, are those of `simulate_forceps`.

    Columns are ``measured/jaw`` (the motor's angle seen at the jaw, ``R phi_m / (z_i r)``),
    ``setpoint/jaw``, ``motor/jaw`` [rad], ``cable/drive`` and ``cable/reset`` (``x1`` and ``x2``
    [m], each only where its encoder is installed), ``truth/jaw`` (reference encoder, the paper's
    truth), ``truth_exact/jaw`` (what no laboratory has), ``truth_load/jaw`` (external torque [Nm])
    and the cables' tensions ``truth_tension/drive`` and ``truth_tension/reset`` [N].

    >>> len(record_forceps(ForcepsParameters.read(), "verification", seed=1))
    12967
    """
    path, mass, session, notes = motion, load.mass, "", ""
    if isinstance(motion, LoadTest):
        session = f"load {seed}"
        mass, angle = motion.mass, math.degrees(motion.angle)
        notes = f"load test: {1e3 * mass:g} g {motion.direction} the motion to {angle:g} deg"
    elif isinstance(motion, str):
        session, path = f"{motion} {seed}", trajectory(motion).positions[:, 0]
    run = simulate_forceps(
        parameters,
        cast("Any", path),
        seed=seed,
        log_rate=log_rate,
        zero_shift=zero_shift,
        load=load,
    )
    columns = {
        "t": run.t,
        **{name: values for name, values in run.columns().items() if "velocity" not in name},
        "truth/jaw": run.truth.position[:, 0],
    }
    provenance = Provenance(
        robot="forceps",
        source=f"virtual forceps, seed {seed}",
        session=session,
        homing_id=f"zero shift: motor {zero_shift.motor * 1e3:.4f} mrad, "
        f"drive {zero_shift.drive * 1e6:.3f} um, reset {zero_shift.reset * 1e6:.3f} um",
        load=mass,
        rates={"state": 1.0 / float(run.t[1] - run.t[0])},
        notes=notes,
    )
    robot = replace(
        get_robot("forceps"), mechanism=parameters.mechanism.mechanism(), transmission=None
    )
    return Recording.from_columns(columns, provenance, robot=robot)


record = lru_cache(maxsize=16)(record_forceps)
"""`record_forceps`, kept: several methods learn from one recording; half a megabyte each."""
