"""Trajectory files: CSV with provenance, and the laboratory's three bare columns."""

import json
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import pandas as pd

from truejoint import files, schema
from truejoint.array_types import Array
from truejoint.errors import TrajectoryError, words
from truejoint.motion.trajectory import Trajectory, as_trajectory
from truejoint.schema import Bounds

_MARK: Final = "# truejoint trajectory "
_FORMAT: Final = 2
_LAB_JOINTS: Final = ("shoulder", "elbow", "insertion")
_LAB_UNITS: Final = ("rad", "rad", "m")
_MAX_BYTES: Final = 1 << 30  # a day at 50 Hz of seven joints is below
_MAX_HEADER: Final = 1 << 16


def write_trajectory(
    trajectory: Trajectory, path: str | os.PathLike[str], *, overwrite: bool = False
) -> None:
    """Write a trajectory as CSV, whole or not at all.

    A ``#`` line of provenance stands first, then a header, then values in full precision.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like
    overwrite : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    TrajectoryError
        If the file exists and `overwrite` is false, or cannot be written.

    Examples
    --------
    >>> path = zigzag(truejoint.get_robot("raven2"), "J2-J3")
    >>> write_trajectory(path, "zigzag.csv")  # doctest: +SKIP
    """
    trajectory, path = as_trajectory(trajectory), Path(path)
    table = pd.DataFrame(trajectory.positions, columns=list(trajectory.joints))
    if trajectory.times is not None:
        table.insert(0, "t", trajectory.times)
    header: dict[str, Any] = {
        "format": _FORMAT,
        "name": trajectory.name,
        "units": dict(zip(trajectory.joints, trajectory.units, strict=True)),
        "meta": dict(trajectory.meta),
    }
    try:
        header = json.loads(json.dumps(header, allow_nan=False))  # as it will be read
        digest = files.content_hash(header, {"rows": table.to_numpy()})
        text = json.dumps(header | {"sha256": digest})
    except (TypeError, ValueError) as error:
        raise TrajectoryError(f"{path}: meta cannot be written as JSON: {error}") from None
    if len(text) + len(_MARK) >= _MAX_HEADER:
        raise TrajectoryError(f"{path}: meta takes {len(text)} characters; keep it below 64 kB")

    def write(part: Path) -> None:
        with part.open("w", encoding="utf-8", newline="") as file:
            file.write(f"{_MARK}{text}\n")
            table.to_csv(file, index=False, lineterminator="\n")

    files.write_atomically(path, write, overwrite=overwrite, error=TrajectoryError)


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a CSV of `write_trajectory`, or the laboratory's three columns without a header.

    Those are shoulder [rad], elbow [rad] and insertion [m], as
    uw-biorobotics/raven2_CRTK_Python_controller writes them.

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
    files.require_ordinary(path, TrajectoryError)
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
    try:
        plain = json.loads(first.removeprefix(_MARK))
    except (ValueError, RecursionError):
        raise TrajectoryError("its first line is damaged; get the file again") from None
    header = schema.read(_Header, plain, "its first line", TrajectoryError)
    columns = second.strip().split(",")
    joints = tuple(columns[columns[0] == "t" :])
    if joints != tuple(header.units):
        raise TrajectoryError(
            f"columns {columns!s:.300} do not match the joints {list(header.units)!s:.300} of its "
            "first line"
        )
    values, meta = _read_numbers(path, len(columns), skip=2), header.meta
    stated = {key: value for key, value in plain.items() if key != "sha256"}
    if not header.sha256:
        notes = filter(None, (str(meta.get("notes", "")), files.UNHASHED))
        meta = {**meta, "notes": "; ".join(notes)}
    elif not files.is_as_written(header.sha256, stated, {"rows": values}):
        raise TrajectoryError(
            "its content does not match its hash; get the file again, or, if it was edited on "
            'purpose, take "sha256" out of its first line'
        )
    units, timed = tuple(header.units.values()), len(joints) < len(columns)
    times, positions = (values[:, 0], values[:, 1:]) if timed else (None, values)
    return Trajectory(joints, units, positions, times, header.name, meta)


class _Header(NamedTuple):
    """First line of a file, after its mark."""

    format: Annotated[int, Bounds(_FORMAT, _FORMAT)]
    name: str
    units: Mapping[str, str]
    meta: Mapping[str, Any]
    sha256: str = ""


def _read_lab(path: Path, first: str) -> Trajectory:
    try:
        n_numbers = len([float(cell) for cell in first.split(",")])
    except ValueError:
        n_numbers = 0
    if n_numbers != len(_LAB_JOINTS):
        raise TrajectoryError(
            f"starts with {first.strip()[:40]!r}; want a file that truejoint saved, or "
            f"{', '.join(_LAB_JOINTS)} in rad, rad, m without a header"
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
                path, delimiter=",", comments=None, encoding="utf-8", skiprows=skip, ndmin=2
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
    return values
