"""Recordings of virtual forceps, in the shape that a laboratory's would have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from truejoint.recordings import Recording
from truejoint.recordings.recording import Provenance
from truejoint.studies.forceps.motions import Plain, built, plain_specimen, record, title_of
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import Table


def parts(settings: Settings) -> Sequence[Part]:
    """One a motion."""
    common = {
        "forceps": plain_specimen(settings["specimen"]),
        "specimen": title_of(settings["specimen"]),
        "load": settings["load_g"] / 1e3,
        "direction": settings["direction"],
        "log_rate": settings["log_rate_hz"],
        "seed": settings.seed,
    }
    return [
        Part(f"motion-{number}", recorded, {"motion": motion, **common})
        for number, motion in enumerate(settings["motions"])
    ]


def recorded(forceps: Plain, motion: str, **options: object) -> PartResult:
    """Columns of a recording of one motion, its units and provenance; `options` as of `record`."""
    recording = record(built(forceps), motion, **options)  # type: ignore[arg-type]
    numbers = {"provenance": recording.provenance.to_dict(), "units": dict(recording.units)}
    return PartResult(numbers, {name: recording.column(name) for name in recording.table.columns})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Give the recordings, and what they hold."""
    recordings = {
        f"{motion}-{title_of(settings['specimen'])}": Recording.from_columns(
            result.arrays,
            Provenance.from_dict(result.numbers["provenance"]),
            result.numbers["units"],
        )
        for motion, result in zip(settings["motions"], results.values(), strict=True)
    }
    rows = tuple(
        (
            name,
            str(len(recording)),
            f"{recording.duration:.1f}",
            f"{np.degrees(np.ptp(recording.column('truth/jaw'))):.0f}",
            f"{1e3 * recording.provenance.load:.0f}",
        )
        for name, recording in recordings.items()
    )
    header = ("recording", "rows", "duration [s]", "jaw covers [deg]", "load [g]")
    numbers = {
        name: {"rows": len(recording), "duration": recording.duration}
        for name, recording in recordings.items()
    }
    return Summary((Table("Recordings", header, rows),), numbers, recordings=recordings)
