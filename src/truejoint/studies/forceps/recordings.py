"""Recordings of virtual forceps, in the shape that a laboratory's would have."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from truejoint.recordings import Recording
from truejoint.recordings.table.recording import Provenance
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.studies.forceps.motions import Plain, load_test, plain_specimen, record, title_of
from truejoint.studies.study import Part, PartResult, Results, Settings, Summary


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
    recording = record(ForcepsParameters.from_dict(forceps), chosen, **how)
    origin = json.dumps([recording.provenance.to_dict(), dict(recording.units)])
    columns = {name: recording.column(name) for name in recording.table.columns}
    return PartResult([{"motion": motion, "origin": origin}], columns)


def summarise(results: Results) -> Summary:
    """Give the recordings."""
    recordings = {}
    for part, motion, origin in results.rows[["part", "motion", "origin"]].to_numpy():
        provenance, units = json.loads(origin)
        recordings[f"{motion}-{title_of(results.settings['specimen'])}"] = Recording.from_columns(
            results.arrays[part], Provenance.from_dict(provenance), units
        )
    return Summary(recordings=recordings)
