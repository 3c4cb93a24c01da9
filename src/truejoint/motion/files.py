"""Trajectory files: CSV with provenance, and the laboratory's three bare columns."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import numpy as np
import pandas as pd

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import TrajectoryError, words
from truejoint.files import (
    UNHASHED,
    content_hash,
    is_as_written,
    require_ordinary,
    write_atomically,
)
from truejoint.motion.trajectory import Trajectory, as_trajectory
from truejoint.schema import Bounds

_MARK: Final = "# truejoint trajectory "
_FORMAT: Final = 2
_LAB_JOINTS: Final = ("shoulder", "elbow", "insertion")
_LAB_UNITS: Final = ("rad", "rad", "m")
# A day at 50 Hz of seven joints is below both.
_MAX_BYTES: Final = 1 << 30
_MAX_ROWS: Final = 10_000_000
_MAX_COLUMNS: Final = 65
_MAX_HEADER: Final = 1 << 16


def write_trajectory(
    trajectory: Trajectory,
    path: str | os.PathLike[str],
    *,
    layout: Literal["own", "lab"] = "own",
    overwrite: bool = False,
) -> None:
    """Write a trajectory as CSV, whole or not at all.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like
    layout : {"own", "lab"}
        ``"own"``: one ``#`` line of provenance, a header, then values in full precision. ``"lab"``:
        a path as the follower of uw-biorobotics/raven2_CRTK_Python_controller reads it, shoulder
        [rad], elbow [rad] and insertion [m] without a header, points at most a thousandth of each
        joint's range apart (traj_generator/snake_generator.py).
    overwrite : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    TrajectoryError
        If the file exists and `overwrite` is false, or cannot be written; for ``"lab"`` also if
        the trajectory has times or other joints.

    Examples
    --------
    >>> path = zigzag(truejoint.get_robot("raven2"), "J2-J3")
    >>> write_trajectory(path, "zigzag.csv")  # doctest: +SKIP
    """
    trajectory, path = as_trajectory(trajectory), Path(path)
    if layout not in ("own", "lab"):
        raise TrajectoryError(f"layout {layout!r:.60}; write 'own' or 'lab'")
    if layout == "lab":
        if (trajectory.joints, trajectory.units) != (_LAB_JOINTS, _LAB_UNITS):
            raise TrajectoryError(
                f"{path}: the laboratory's files hold {', '.join(_LAB_JOINTS)} in rad, rad, m; "
                f"{trajectory.name} has {', '.join(trajectory.joints)}"
            )
        first, table = "", pd.DataFrame(trajectory.densified(1e-3).positions)
    else:
        table = pd.DataFrame(trajectory.positions, columns=list(trajectory.joints))
        if trajectory.times is not None:
            table.insert(0, "t", trajectory.times)
        first = _header(trajectory, table.to_numpy(), path)

    def write(part: Path) -> None:
        with part.open("w", encoding="utf-8", newline="") as file:
            file.write(first)
            table.to_csv(file, index=False, header=bool(first), lineterminator="\n")

    write_atomically(path, write, overwrite=overwrite, error=TrajectoryError)


def _header(trajectory: Trajectory, rows: Array, path: Path) -> str:
    header: dict[str, Any] = {
        "format": _FORMAT,
        "name": trajectory.name,
        "units": dict(zip(trajectory.joints, trajectory.units, strict=True)),
        "meta": dict(trajectory.meta),
    }
    try:
        header = json.loads(json.dumps(header, allow_nan=False))  # as it will be read
        text = json.dumps(header | {"sha256": content_hash(header, {"rows": rows})})
    except (TypeError, ValueError) as error:
        raise TrajectoryError(f"{path}: meta cannot be written as JSON: {error}") from None
    if len(text) + len(_MARK) >= _MAX_HEADER:
        raise TrajectoryError(f"{path}: meta takes {len(text)} characters; keep it below 64 kB")
    return f"{_MARK}{text}\n"


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a CSV of either layout of `write_trajectory`, found from its first line.

    Raises
    ------
    TrajectoryError
        If the file is missing, too large, damaged, edited (its content differs from its hash) or
        of another layout. One without a hash is read, and its ``meta["notes"]`` say so.

    Examples
    --------
    >>> read_trajectory("zigzag.csv").units  # doctest: +SKIP
    ('rad', 'rad', 'm')
    """
    path = Path(path)
    require_ordinary(path, TrajectoryError)
    try:
        size = path.stat().st_size
        with path.open(encoding="utf-8", newline="") as file:
            first, second = file.readline(_MAX_HEADER), file.readline(_MAX_HEADER)
    except OSError as error:
        raise TrajectoryError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise TrajectoryError(f"{path}: is not text; want a trajectory CSV") from None
    if size > _MAX_BYTES:
        raise TrajectoryError(f"{path}: {size} bytes is more than a trajectory may have (1 GiB)")
    try:
        if first.startswith(_MARK):
            return _read_own(path, first, second)
        return _read_lab(path, first)
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error}") from None


def _read_own(path: Path, first: str, second: str) -> Trajectory:
    plain = _plain_header(first)
    header = schema.read(_Header, plain, "its first line", TrajectoryError)
    columns = second.strip().split(",")
    if len(columns) > _MAX_COLUMNS:
        raise TrajectoryError(f"{len(columns)} columns; at most {_MAX_COLUMNS}")
    timed = columns[0] == "t"
    joints = tuple(columns[1:] if timed else columns)
    if joints != tuple(header.units):
        raise TrajectoryError(
            f"columns {columns} do not match the joints {list(header.units)} of its first line"
        )
    values, meta = _read_numbers(path, len(columns), skip=2), header.meta
    stated = {key: value for key, value in plain.items() if key != "sha256"}
    if not header.sha256:
        notes = filter(None, (str(meta.get("notes", "")), UNHASHED))
        meta = {**meta, "notes": "; ".join(notes)}
    elif not is_as_written(header.sha256, stated, {"rows": values}):
        raise TrajectoryError(
            "its content does not match its hash; get the file again, or, if it was edited on "
            'purpose, take "sha256" out of its first line'
        )
    times, positions = (values[:, 0], values[:, 1:]) if timed else (None, values)
    return Trajectory(joints, tuple(header.units.values()), positions, times, header.name, meta)


class _Header(NamedTuple):
    """First line of a file, after its mark."""

    format: Annotated[int, Bounds(_FORMAT, _FORMAT)]
    name: str
    units: Mapping[str, str]
    meta: Mapping[str, Any]
    sha256: str = ""


def _plain_header(first: str) -> Any:
    try:
        return json.loads(first.removeprefix(_MARK))
    except (ValueError, RecursionError):
        raise TrajectoryError("its first line is damaged; get the file again") from None


def _read_lab(path: Path, first: str) -> Trajectory:
    cells = first.strip().split(",")
    try:
        [float(cell) for cell in cells]
    except ValueError:
        raise TrajectoryError(
            f"starts with {first.strip()[:40]!r}; want a file that truejoint saved, or "
            f"{', '.join(_LAB_JOINTS)} in rad, rad, m without a header"
        ) from None
    if len(cells) != len(_LAB_JOINTS):
        raise TrajectoryError(
            f"{len(cells)} columns without a header; want {', '.join(_LAB_JOINTS)}"
        )
    values = _read_numbers(path, len(_LAB_JOINTS), skip=0)
    return Trajectory(_LAB_JOINTS, _LAB_UNITS, values, None, path.stem, {"source": path.name})


def _read_numbers(path: Path, columns: int, *, skip: int) -> Array:
    """Numbers (n, columns) after `skip` lines."""
    try:
        with warnings.catch_warnings():
            # No rows is a warning of numpy's and an error of ours, below.
            warnings.simplefilter("ignore", UserWarning)
            values = np.loadtxt(
                path,
                delimiter=",",
                skiprows=skip,
                max_rows=_MAX_ROWS + 1,
                ndmin=2,
                comments=None,
                encoding="utf-8",
            )
    except (ValueError, OSError) as error:  # it unpacks what is called .gz
        raise TrajectoryError(
            f"a row is not {columns} numbers ({words(error)}); get the file again"
        ) from None
    if values.size == 0:
        raise TrajectoryError("has no rows")
    if values.shape[1] != columns:
        raise TrajectoryError(
            f"rows have {values.shape[1]} numbers, want {columns}; get the file again"
        )
    if len(values) > _MAX_ROWS:
        raise TrajectoryError(f"more than {_MAX_ROWS} rows; split it")
    return values
