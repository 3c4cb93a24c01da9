"""Faults that tests put into recordings, and findings by name."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from truejoint.recordings import DataCheck, Finding, Recording

Change = Callable[[np.ndarray], Any]


def changed(recording: Recording, **changes: np.ndarray | Change) -> Recording:
    """Other values in columns, or a change of those there; names have two underscores for `/`."""
    columns = {
        name: values(recording.column(name).copy()) if callable(values) else values
        for name, values in ((n.replace("__", "/"), v) for n, v in changes.items())
    }
    return replace(recording, table=recording.table.assign(**columns))


def in_all(recordings: Sequence[Recording], **changes: Change) -> list[Recording]:
    """Columns of each recording with a fault."""
    return [changed(recording, **changes) for recording in recordings]


def in_first(recordings: Sequence[Recording], **changes: Change) -> list[Recording]:
    """Columns of the first recording with a fault."""
    return [changed(recordings[0], **changes), *recordings[1:]]


def added(rows: Any, by: Any) -> Change:
    """Add to the values of some rows; NaN takes them away."""

    def change(values: np.ndarray) -> np.ndarray:
        values[rows] += by
        return values

    return change


def stuck(first: int, last: int) -> Change:
    """Repeat one value between two rows."""
    return lambda x: np.concatenate([x[:first], np.full(last - first, x[first]), x[last:]])


def late(recording: Recording, seconds: float) -> Recording:
    """A truth of all joints that is later."""
    t = recording.t
    return of_quantity(recording, "truth", lambda x: np.interp(t - seconds, t, x))


def of_quantity(recording: Recording, quantity: str, change: Change) -> Recording:
    """One change of all columns of a quantity."""
    joints = recording.joints_of(quantity)
    return changed(recording, **{f"{quantity}__{joint}": change for joint in joints})


def by_heading(check: DataCheck) -> dict[str, Finding]:
    """Worst finding under each heading."""
    return {finding.heading: finding for finding in check.by_heading()}


def named(check: DataCheck, name: str) -> list[Finding]:
    """Findings of a name."""
    return [finding for finding in check.findings if finding.name == name]


def names(check: DataCheck) -> set[str]:
    """Names of findings that are more than information."""
    return {finding.name for finding in check.findings if finding.level in ("warn", "fail")}
