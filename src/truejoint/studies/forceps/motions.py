"""Specimens, and recordings of them on the motions of yan2020."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.errors import TruejointError
from truejoint.motion import Trajectory, nested_motion
from truejoint.motion import forceps_trajectories as paths
from truejoint.recordings import Recording
from truejoint.robots import get_robot
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.specimens import specimen as shipped
from truejoint.studies.forceps.record_forceps import record_forceps
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


def plain_specimen(name: str) -> Plain:
    """Plain values of a shipped specimen, or of a designer's TOML file."""
    return (ForcepsParameters.read(name) if name.endswith(".toml") else shipped(name)).to_dict()


def title_of(name: str) -> str:
    """Name of a specimen, or of its file."""
    return Path(name).stem if name.endswith(".toml") else name


def drawn_specimens(settings: Settings) -> list[tuple[str, Plain, int]]:
    """Specimens that a study is made on, each with a name and a seed of its own.

    The one named by the option ``specimen``, or as many of a population as ``count`` says.
    """
    if not settings["count"]:
        name = settings["specimen"]
        return [(f"specimen-{title_of(name)}", plain_specimen(name), settings.seed)]
    plants = population(settings["count"], settings.seed, settings["prior"])
    return [(f"specimen-{n:05d}", plant.to_dict(), n) for n, plant in enumerate(plants)]


def built(forceps: Plain) -> ForcepsParameters:
    """Specimen of its plain values."""
    return ForcepsParameters.from_dict(forceps)


@lru_cache(maxsize=16)  # several methods learn from one recording; half a megabyte each
def record(
    forceps: ForcepsParameters, motion: str | LoadTest, *, seed: int = 0, **how: Any
) -> Recording:
    """Record a specimen on a motion of the paper; `how` is as `record_forceps` takes it.

    That is ``"calibration"``, (27), ``"verification"``, (28), ``"cycle"``, a period of (27), the
    load test of IV-D, or ``"nested"``, our own `nested_motion`. Raises TruejointError if it is
    unknown, or the plant refuses a value.

    >>> len(record(ForcepsParameters.read(), "verification", seed=1))
    12967
    """
    if isinstance(motion, str) and motion not in _TRAJECTORIES:
        names = ", ".join(_TRAJECTORIES)
        raise TruejointError(f"no motion {motion!r:.60}; choose one of {names}, or a load test")
    path = _TRAJECTORIES[motion]().positions[:, 0] if isinstance(motion, str) else motion
    session = f"{motion if isinstance(motion, str) else 'load'} {seed}"
    return record_forceps(forceps, path, seed=seed, session=session, **how)


def changed(recording: Recording, name: str, values: ArrayLike) -> Recording:
    """Put another column `name` (n,) into a recording."""
    table = recording.table.assign(**{name: np.asarray(values, dtype=np.float64)})
    return Recording(table, recording.units, recording.provenance)
