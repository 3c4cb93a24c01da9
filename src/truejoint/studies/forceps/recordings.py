"""Recordings of virtual forceps, in the shape that a laboratory's would have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from truejoint.recordings import Recording
from truejoint.recordings.table.recording import Provenance
from truejoint.studies.forceps.loaded import load_test
from truejoint.studies.forceps.motions import Plain, built, plain_specimen, record, title_of
from truejoint.studies.study import Part, PartResult, Settings, Summary


def parts(settings: Settings) -> Sequence[Part]:
    """One a motion."""
    common = {
        "forceps": plain_specimen(settings["specimen"]),
        "specimen": title_of(settings["specimen"]),
        "mass": settings["load_g"] / 1e3,
        "direction": settings["direction"],
        "log_rate": settings["log_rate_hz"],
        "seed": settings.seed,
    }
    return [Part(motion, recorded, {"motion": motion, **common}) for motion in settings["motions"]]


def recorded(forceps: Plain, motion: str, mass: float, direction: str, **how: Any) -> PartResult:
    """Record a motion: columns, their units and the provenance; `how` is as `record` takes it."""
    chosen = load_test(mass, direction) if motion == "load" else motion
    recording = record(built(forceps), chosen, **how)
    numbers = {"provenance": recording.provenance.to_dict(), "units": dict(recording.units)}
    return PartResult(numbers, {name: recording.column(name) for name in recording.table.columns})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Give the recordings."""
    recordings = {
        f"{motion}-{title_of(settings['specimen'])}": Recording.from_columns(
            part.arrays, Provenance.from_dict(part.numbers["provenance"]), part.numbers["units"]
        )
        for motion, part in results.items()
    }
    return Summary(recordings=recordings)
