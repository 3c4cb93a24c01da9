"""Was the test really held out? What training says about itself, against the recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

from truejoint.calibration.conformal import trained_on
from truejoint.recordings.recording import Recording


def seen_in_training(
    metadata: Mapping[str, Any], recordings: Sequence[Recording]
) -> tuple[str, ...]:
    """Object to each test recording whose rows were in the training (`trained_on`)."""
    names = [_name(r) or "a recording" for r in recordings if trained_on(metadata, r)]
    return tuple(
        f"the model was trained on rows of {name}, which it is tested on" for name in names
    )


def other_homings(metadata: Mapping[str, Any], recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Tell when the test was recorded after another homing than the ``homing_ids`` of training."""
    known = set(metadata.get("homing_ids", ()))
    other = sorted({r.provenance.homing_id for r in recordings} - known - {""})
    if not known or not other:
        return ()
    return (
        f"The test has homings that training has not seen ({', '.join(other[:4])}); positions of "
        "two homings differ by an offset that no model knows.",
    )


def rezeroed_on(metadata: Mapping[str, Any], recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Tell when the offset was taken from a recording of the test: see ``rezeroed``."""
    since = metadata.get("rezeroed") or {}
    key = (since.get("source"), since.get("homing_id"))
    for recording in recordings:
        origin = recording.provenance
        if origin.source and key == (origin.source, origin.homing_id):
            return (
                f"The model was re-zeroed on truth of {_name(recording)}, which it is tested on; "
                "what is left of the offset shows only in other recordings.",
            )
    return ()


def _name(recording: Recording) -> str:
    return PurePath(recording.provenance.source).name
