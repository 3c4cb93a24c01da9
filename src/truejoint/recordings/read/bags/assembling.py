"""The recording of an arm, of its topics' messages: on one clock, in SI units, without homing."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.messages import (
    RUN_LEVELS,
    crtk_name,
    joint_state_columns,
    raven_state_columns,
)
from truejoint.errors import RecordingError, RobotError
from truejoint.recordings.join.joining import cover_same_time, join_truth
from truejoint.recordings.read.bags.fields import STAMP
from truejoint.recordings.read.bags.series import Lot, Series, keep_rows
from truejoint.recordings.read.bags.wiring import HOMED, Wiring
from truejoint.recordings.read.raven_csv import without_homing
from truejoint.recordings.table.recording import (
    MISSING,
    Provenance,
    Recording,
    last_of_each_stamp,
    nominal_rates,
)
from truejoint.recordings.table.signals import GAP_STEPS
from truejoint.recordings.table.stream import Stream, synchronise, usable_rows
from truejoint.robots import Robot

_SECOND: Final = 1e9  # ns
_RAVEN_VALUES: Final = 16  # in each list of RAVEN's state: of both arms


def assemble(
    lots: Iterable[Lot],
    robot: Robot,
    wiring: Wiring,
    quantities: Collection[str],
    origin: Provenance,
    lost: Mapping[str, int],
    place: str,
    offset: float | None = None,
    near: float | None = None,
) -> Recording:
    """Make the recording of an arm of the messages of its topics, in whatever lots they come.

    Parameters
    ----------
    lots : iterable of Lot
        With the fields that `wanted_fields` names.
    robot : Robot
    wiring : Wiring
    quantities : collection of str
        Of `RAVEN_FIELDS`.
    origin : Provenance
        What is known of where they come from.
    lost : mapping of str to int
        What could not be read, by reason; counted while `lots` are drawn.
    place : str
        Where they come from, for messages.
    offset, near : float, optional
        As `read_bag` takes them.

    Raises
    ------
    RecordingError
        If a topic has no message, or one that is no joint state of the robot.
    """
    series = _series_of(lots, robot, wiring, quantities, place)
    for name in filter(None, (wiring.state, wiring.truth)):
        if not series[name].count:
            raise RecordingError(f"{place}: {name} has no message that can be read")
    base = series[wiring.state].start
    dropped: dict[str, int] = {}
    columns = _columns(series[wiring.state], base, "state", dropped)
    if series[wiring.homed].count:
        _leave_out_unhomed(columns, series[wiring.homed], base, dropped)
    rates = nominal_rates(state=columns["t"])
    for name in wiring.others:
        if series[name].count > 1:
            other = _stream(series[name], base, name, dropped)
            added = [name for name in other.columns if name not in columns]
            columns |= _at(columns["t"], other, added)
    dropped |= _keep_known(columns)
    dropped |= lost  # counted to the end of the files, which is now
    provenance = replace(origin, rates=rates, dropped=dropped, notes=_notes(wiring))
    recording = Recording.from_columns(columns, provenance, robot=robot, copy=False)
    if wiring.truth:
        counts: dict[str, int] = {}
        truth = _stream(series[wiring.truth], base, "truth", counts)
        recording = replace(
            recording, provenance=replace(provenance, dropped={**dropped, **counts})
        )
        recording = _with_truth(recording, truth, offset, near)
    return replace(recording, provenance=replace(recording.provenance, start=base / _SECOND))


def _series_of(
    lots: Iterable[Lot],
    robot: Robot,
    wiring: Wiring,
    quantities: Collection[str],
    place: str,
) -> dict[str, Series]:
    """Columns of the topics of a wiring, by topic."""
    quantity_of = {wiring.state: "measured", wiring.truth: "truth"} | {
        name: crtk_name(name).partition("_")[0] for name in wiring.others
    }
    series = {name: Series() for name in (*wiring.joints, wiring.homed)}
    for lot in lots:
        _require_numbers(lot, wiring, place)
        if lot.topic == wiring.homed:
            columns = {HOMED: lot.fields[HOMED][:, 0].astype(np.float64)}
        elif "runlevel" in lot.fields:
            columns = raven_state_columns(robot, lot.fields, quantities)
            columns["state/run_level"] = lot.fields["runlevel"][:, 0].astype(np.float64)
        else:
            names = lot.texts.get("name", ())
            try:
                columns = joint_state_columns(
                    robot, quantity_of[lot.topic], names, lot.fields, wiring.profile
                )
            except RobotError as error:
                raise RecordingError(f"{place}: {lot.topic}: {error}") from None
        series[lot.topic].add(lot.places, lot.stamps, columns)
    return series


def _require_numbers(lot: Lot, wiring: Wiring, place: str) -> None:
    """Raise RecordingError where a message of a known type has other fields than that type."""
    if lot.topic == wiring.homed:
        least = {HOMED: 1}
    elif "runlevel" in lot.fields:
        least = {field: _RAVEN_VALUES for field in lot.fields if field not in ("runlevel", STAMP)}
        least["runlevel"] = 1
    else:
        least = {"position": 0}
    for field, values in least.items():
        if field not in lot.fields or lot.fields[field].shape[1] < values:
            raise RecordingError(
                f"{place}: {lot.topic}: its {field} is not as such a message has it"
            )


def _with_truth(
    recording: Recording, truth: Stream, offset: float | None, near: float | None
) -> Recording:
    """Join the truth by stamps, or by motion where they have too little in common."""
    notes = recording.provenance.notes
    if offset is None and near is None and cover_same_time(recording.t, truth.t):
        joined, _ = join_truth(recording, truth, 0.0)
        return replace(joined, provenance=replace(joined.provenance, notes=notes))
    return join_truth(recording, truth, offset, near=near)[0]


def _stream(series: Series, base: int, name: str, dropped: dict[str, int]) -> Stream:
    """Columns of a topic at stamps [s] since `base` [ns] that rise."""
    columns = _columns(series, base, name, dropped)
    return Stream(columns.pop("t"), columns)


def _columns(series: Series, base: int, name: str, dropped: dict[str, int]) -> dict[str, Array]:
    """Columns of a topic, with ``t`` [s] since `base` [ns] that rises, without homing."""
    stamps, columns = series.joined()
    last = last_of_each_stamp(stamps)
    levels = columns.get("state/run_level")
    keep, homing = (last, {}) if levels is None else without_homing(levels)
    repeated = int((~last).sum())
    dropped |= ({f"{name}: repeated time stamp": repeated} if repeated else {}) | homing
    rows = np.flatnonzero(last & keep).astype(np.float64)
    t = (stamps[last & keep] - base) / _SECOND
    # By their numbers alone: the columns of a day take much memory.
    usable = usable_rows(Stream(t, {"row": rows}), name, dropped)
    if len(usable.t) < len(stamps):
        keep_rows(columns, usable.columns["row"].astype(np.int64))
    return {"t": usable.t, **columns}


def _leave_out_unhomed(
    columns: dict[str, Array], homed: Series, base: int, dropped: dict[str, int]
) -> None:
    """Leave out rows of a state before, and amid which, its arm said that it was not homed.

    One that never says that it is homed has no homing.
    """
    stamps, said = homed.joined()
    order = np.argsort(stamps, kind="stable")
    t, is_homed = (stamps[order] - base) / _SECOND, said[HOMED][order] > 0.0
    last = np.maximum(np.searchsorted(t, columns["t"], side="right") - 1, 0)
    if not is_homed[last].any():
        return
    names = np.where(is_homed[last], RUN_LEVELS["pedal down"], RUN_LEVELS["homing"])
    keep, homing = without_homing(names.astype(np.float64))
    dropped |= homing
    if not keep.all():
        keep_rows(columns, np.flatnonzero(keep))


def _keep_known(columns: dict[str, Array]) -> dict[str, int]:
    """Keep the rows in which no value is missing, and count the others."""
    finite = np.ones(len(columns["t"]), dtype=np.bool_)
    for values in columns.values():
        finite &= np.isfinite(values)
    if finite.all():
        return {}
    keep_rows(columns, np.flatnonzero(finite))
    return {f"state: {MISSING} in one of its topics": int((~finite).sum())}


def _at(t: Array, other: Stream, names: Collection[str]) -> dict[str, Array]:
    """Columns `names` of another topic at the stamps `t` (n,) [s]; NaN where it is silent."""
    chosen = Stream(other.t, {name: other.columns[name] for name in names})
    columns, _ = synchronise(Stream(t, {}), chosen, GAP_STEPS * float(np.median(np.diff(other.t))))
    del columns["t"]
    return columns


def _notes(wiring: Wiring) -> str:
    """Say what was read, and what the profile changed of it."""
    profile = wiring.profile
    topics = f"state of {wiring.state}"
    if wiring.others:
        topics += f" and {', '.join(wiring.others)}"
    notes = [topics + (f", truth of {wiring.truth}" if wiring.truth else "")]
    if profile.name != "crtk":
        notes.append(f"profile {profile.name}: {profile.summary}")
    if wiring.truth and profile.truth_offsets:
        added = ", ".join(f"{shift:+.6g} to {j}" for j, shift in profile.truth_offsets.items())
        notes.append(f"added to the truth [rad or m]: {added}")
    return "; ".join(notes)
