"""Headers of truejoint's own files: JSON that says what is in a file, with a hash of all of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from truejoint.array_types import Array
from truejoint.errors import RecordingError, RobotError
from truejoint.files import content_hash, is_as_written
from truejoint.recordings.table.recording import Provenance
from truejoint.robots import Robot, robot_of

KEY: Final = b"truejoint"
"""Key of the header among an Arrow schema's metadata."""


def sign(header: Mapping[str, Any], arrays: Mapping[str, Array]) -> bytes:
    """JSON of a header with the hash of itself and of `arrays`."""
    signed = {**header, "sha256": content_hash(header, arrays)}
    return json.dumps(signed, allow_nan=False).encode()


def parse_header(metadata: Mapping[bytes, bytes] | None) -> dict[str, Any] | None:
    """Values of the header among an Arrow schema's metadata; None where there is none."""
    with suppress(ValueError, RecursionError):
        values = json.loads((metadata or {}).get(KEY, b""))
        return values if isinstance(values, dict) else None
    return None


def check_version(source: Path, header: Mapping[str, Any], version: int) -> None:
    """Raise RecordingError for a file of another version."""
    if header.get("version") != version:
        raise RecordingError(
            f"{source}: is of version {header.get('version')!s:.20}, this truejoint reads "
            f"{version}; update truejoint"
        )


def is_unchanged(header: dict[str, Any], arrays: Mapping[str, Array]) -> bool:
    """Whether a header, and `arrays`, are as they were signed; takes the hash out of the header."""
    return is_as_written(header.pop("sha256", None), header, arrays)


def recording_header(provenance: Provenance, robot: Robot) -> dict[str, Any]:
    """Entries of a header that say what was recorded, and of which robot."""
    return {"provenance": provenance.to_dict(), "robot": robot.to_dict()}


def recorded(source: Path, header: Mapping[str, Any]) -> tuple[Provenance, Robot]:
    """Inverse of `recording_header`; raises RecordingError where the header is damaged."""
    values, robot = header.get("provenance"), header.get("robot")
    if not isinstance(values, dict) or not isinstance(robot, dict):
        raise RecordingError(f"{source}: its metadata is damaged; copy or record it again")
    try:
        return Provenance.from_dict(values), robot_of(robot, source.name)
    except (RecordingError, RobotError) as error:
        raise RecordingError(f"{source}: {str(error).removeprefix(f'{source.name}: ')}") from None
