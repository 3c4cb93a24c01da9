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
    """Find test recordings whose rows were in the training.

    Two recordings are the same when their hashes are equal, or, where there is no hash, source,
    session, homing and start. Parts of one count as seen when their times overlap.

    Parameters
    ----------
    metadata : mapping
        Of the calibration; ``sessions`` lists the training recordings with ``source``,
        ``sha256``, ``session``, ``homing_id``, ``start`` and the time stamps ``first`` and
        ``last`` [s].
    recordings : sequence of Recording
        Of the test.

    Returns
    -------
    tuple of str
        One objection for each recording that was seen; empty when the test was held out.
    """
    found = []
    for recording in recordings:
        if trained_on(metadata, recording):
            name = PurePath(recording.provenance.source).name or "a recording"
            found.append(f"the model was trained on rows of {name}, which it is tested on")
    return tuple(found)


def other_homings(metadata: Mapping[str, Any], recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Tell when the test was recorded after another homing than any of the training.

    Parameters and result as in `seen_in_training`; ``homing_ids`` lists the training's homings.
    """
    known = set(metadata.get("homing_ids", ()))
    other = sorted({r.provenance.homing_id for r in recordings} - known - {""})
    if not known or not other:
        return ()
    return (
        f"The test has homings that training has not seen ({', '.join(other[:4])}); positions of "
        "two homings differ by an offset that no model knows.",
    )


def rezeroed_on(metadata: Mapping[str, Any], recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Tell when the offset was taken from the recording that the test is on, or from a part of it.

    Parameters and result as in `seen_in_training`; ``rezeroed`` holds the ``source`` and the
    ``homing_id`` of that truth.
    """
    since = metadata.get("rezeroed") or {}
    key = (since.get("source"), since.get("homing_id"))
    for origin in (recording.provenance for recording in recordings):
        if origin.source and key == (origin.source, origin.homing_id):
            return (
                f"The model was re-zeroed on truth of {PurePath(origin.source).name}, which it is "
                "tested on; what is left of the offset shows only in other recordings.",
            )
    return ()
