"""`truejoint correct`: put recordings right with a calibration, as the robot's loop would."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import truejoint
from truejoint.cli.console import print_table, progress, say
from truejoint.cli.options import Result, share
from truejoint.cli.recording_options import DataCheck, Files, say_failed
from truejoint.errors import RecordingError
from truejoint.files import check_target, write_atomically
from truejoint.units import SI_UNITS, plural

if TYPE_CHECKING:
    import pandas as pd

# Fewer corrected rows than this share of a recording, and the model is not for it.
_LEAST_CORRECTED = 0.5
_NOT_JUDGED = "NOT_JUDGED"
_POSITIONS = ("measured", "corrected", "half_width")
_DECIMALS = (9, 6)  # of a text's numbers, and of its stamps [s]


def correct(
    model: Path,
    recordings: list[str],
    output: Path,
    data_check: DataCheck,
    files: Files,
    level_percent: float | None = None,
    rezero_s: float = 0.0,
    part: str | None = None,
    on_fault: Literal["hold", "raw", "silent"] = "hold",
    force: bool = False,
) -> Result:
    """Correct recordings, which need no truth; exit code 1 when most of one could not be.

    A row is corrected, or flagged where the corrector is in doubt, just as in the robot's loop. A
    .csv is in the units of a column map, a .parquet in rad and m.
    With --rezero-s, each recording begins with truth that sets its zero.
    """
    if output.suffix not in {".csv", ".parquet"}:
        raise RecordingError(f"{output}: call it .csv or .parquet")
    check_target(output, overwrite=force)
    if output.exists() and str(output.resolve()) in map(os.path.realpath, recordings):
        raise RecordingError(f"{output}: is to be corrected itself; give the output another name")
    level = share(level_percent)
    calibration = truejoint.read_calibration(model)
    inputs = calibration.feature_set
    loaded = files.find(recordings, part=part, model=calibration, inputs=inputs)()
    names = _names(loaded)
    judged = loaded if rezero_s else [_without_truth(recording) for recording in loaded]
    check = data_check.run(judged, model=calibration, needs_truth=False)
    tables = []
    with progress(f"Correcting {plural(len(loaded), 'recording')}") as done:
        for recording in loaded:
            at_zero = calibration
            if rezero_s:
                zero = truejoint.calibration.find_zero(calibration, recording, rezero_s)
                at_zero = calibration.at(zero)
            tables.append(correct_rows(at_zero, recording, level, on_fault))
            done(len(tables) / len(loaded))
    counts = [_counts(name, table) for name, table in zip(names, tables, strict=True)]
    # The unit of each joint's position in the file, where a column map says another.
    columns = files.column_map.columns if files.column_map else {}
    of_joints = {joint: columns.get(f"measured/{joint}") for joint in calibration.joints}
    units = {joint: column.unit for joint, column in of_joints.items() if column}
    _write(names, tables, output, units, force)
    rows = []
    for each in counts:
        flagged = ", ".join(f"{n} {status}" for status, n in each["flagged"].items()) or "-"
        corrected = f"{100 * each['corrected'] / each['rows']:.1f} %"
        rows.append((each["recording"], f"{each['rows']}", corrected, flagged))
    print_table(("recording", "rows", "corrected", "in doubt, why"), rows, title=str(output))
    say(_interval_line(tables))
    for each in counts:
        for name, n in each["unlearnt"].items():
            words = truejoint.runtime.Unlearnt[name].words
            in_rows = f"in {100 * n / each['rows']:.1f} % of the rows"
            say(f"{name}: {each['recording']}: {in_rows} {words}")
    if any("HOMED_AGAIN" in name for each in counts for name in each["flagged"]):
        homings = ", ".join(calibration.origin.homing_ids) or "none"
        say(
            f"HOMED_AGAIN: the model is for homing {homings}: re-zero it after this one "
            "(--rezero-s, or `truejoint rezero`), or state --metadata homing_id=... if it is "
            "the same"
        )
    say_failed(check)
    enough = all(each["corrected"] >= _LEAST_CORRECTED * each["rows"] for each in counts)
    values = {"out": str(output), "recordings": counts, "check": check.to_dict()}
    return Result(values, passed=enough and not check.failed)


def correct_rows(
    calibration: truejoint.Calibration,
    recording: truejoint.Recording,
    level: float | None,
    on_fault: Literal["hold", "raw", "silent"] = "hold",
) -> pd.DataFrame:
    """Time, measured and corrected positions, half-widths, status of every row, as in the loop.

    Half-widths are NaN where none is stated, and have no column where the model states none. An
    estimator that works on whole recordings only has no row for a loop; nothing is judged then.
    """
    import numpy as np
    import pandas as pd

    from truejoint.recordings.table.recording import EPOCH
    from truejoint.runtime.corrector import corrector_for

    start = recording.provenance.start
    t = recording.t + (start if start > EPOCH else 0.0)  # as the file had them, since 1970
    joints = calibration.joints
    before = {"t": t} | {f"measured/{j}": recording.column(f"measured/{j}") for j in joints}
    if calibration.family.row is None:
        table = calibration.correct_table(recording, level).drop(columns="t")
        return pd.DataFrame(before).join(table).assign(status=_NOT_JUDGED, unlearnt=_NOT_JUDGED)
    calibration.check_recording(recording)
    corrector = corrector_for(calibration, recording, level=level, on_fault=on_fault)
    corrector.set_homing(True, recording.provenance.homing_id or None)
    trace = corrector.run(recording)
    half_width = np.where(np.isfinite(trace.half_width), trace.half_width, np.nan)
    columns = before | {
        f"corrected/{joint}": trace.position[:, k] for k, joint in enumerate(joints)
    }
    if calibration.interval is not None or not np.isnan(half_width).all():
        columns |= {f"half_width/{joint}": half_width[:, k] for k, joint in enumerate(joints)}
    for name, quantity in trace.beside.items():
        columns[f"{name}/{joints[0]}"], columns[f"{name}_half_width/{joints[0]}"] = quantity.T
    kinds = {"status": truejoint.runtime.Status, "unlearnt": truejoint.runtime.Unlearnt}
    for column, kind in kinds.items():
        bits, place = np.unique(getattr(trace, column), return_inverse=True)
        columns[column] = np.array([kind(int(b)).name for b in bits], dtype=object)[place]
    return pd.DataFrame(columns)


def _without_truth(recording: truejoint.Recording) -> truejoint.Recording:
    units = {name: u for name, u in recording.units.items() if not name.startswith("truth/")}
    return replace(recording, table=recording.table[["t", *units]], units=units)


def _names(loaded: list[truejoint.Recording]) -> list[str]:
    names = [r.provenance.session or Path(r.provenance.source).stem for r in loaded]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RecordingError(f"two recordings are called {twice[0]!r}; correct them one at a time")
    return names


def _counts(name: str, table: pd.DataFrame) -> dict[str, Any]:
    """How many rows were corrected, and how many were in doubt, by status."""
    counts = {str(status): int(n) for status, n in table["status"].value_counts().items()}
    corrected = sum(counts.pop(status, 0) for status in ("OK", _NOT_JUDGED))
    warnings = [str(warning.name) for warning in truejoint.runtime.Unlearnt]
    warned = {w: int(table["unlearnt"].str.contains(w).sum()) for w in warnings}
    return {
        "recording": name, "rows": len(table), "corrected": corrected, "flagged": counts,
        "unlearnt": {w: n for w, n in warned.items() if n},
    }  # fmt: skip


def _interval_line(tables: list[pd.DataFrame]) -> str:
    widths = [table.filter(like="half_width/") for table in tables]
    if not any(width.size for width in widths):
        return "no half_width: the model states no interval (truejoint calibrate --interval ...)"
    empty = sum(int(width.isna().any(axis=1).sum()) for width in widths)
    return f"half_width is empty in {plural(empty, 'row')}, of which nothing is stated"


def _write(
    names: list[str], tables: list[pd.DataFrame], output: Path, units: dict[str, str], force: bool
) -> None:
    """One table: of several recordings each row says of which it is."""
    import pandas as pd

    from truejoint.tables import csv_text

    whole = tables[0]
    if len(tables) > 1:
        whole = pd.concat(dict(zip(names, tables, strict=True)), names=["recording", None])
        whole = whole.reset_index("recording")
    write = partial(write_atomically, output, overwrite=force, error=RecordingError)
    if output.suffix == ".parquet":
        return write(whole.to_parquet(index=False))
    for name in whole.select_dtypes("number").columns:
        quantity, _, joint = str(name).partition("/")
        unit = units.get(joint, "") if quantity in _POSITIONS else ""
        whole[name] = (whole[name] / SI_UNITS.get(unit, ("", 1.0))[1]).round(_DECIMALS[name == "t"])
        if unit:
            whole = whole.rename(columns={name: f"{name} [{unit}]"})
    return write(csv_text(whole).encode())
