"""Faults that tests put into recordings, and findings by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from truejoint.recordings import DataCheck, Finding, Recording


def changed(recording: Recording, **columns: np.ndarray) -> Recording:
    """Other values in columns, whose names have two underscores for the stroke."""
    named = {name.replace("__", "/"): values for name, values in columns.items()}
    return replace(recording, table=recording.table.assign(**named))


def stuck(recording: Recording, first: int, last: int) -> Recording:
    """A truth of the elbow that repeats one value between two rows."""
    truth = recording.column("truth/elbow").copy()
    truth[first:last] = truth[first]
    return changed(recording, truth__elbow=truth)


def unset(recording: Recording) -> Recording:
    """Efforts that were never set."""
    zeros = np.zeros(len(recording))
    return changed(recording, **{f"effort__{j}": zeros for j in recording.joints_of("effort")})


def by_heading(check: DataCheck) -> dict[str, Finding]:
    return {finding.heading: finding for finding in check.by_heading()}


def named(check: DataCheck, name: str) -> list[Finding]:
    return [finding for finding in check.findings if finding.name == name]
