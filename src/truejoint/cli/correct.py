"""`truejoint correct`: put recordings right with a calibration, as the robot's loop would."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import truejoint
from truejoint.cli import options
from truejoint.cli.console import plural, print_table, progress, say
from truejoint.cli.options import Result
from truejoint.cli.recording_options import DataCheck, Files, say_failed
from truejoint.errors import RecordingError
from truejoint.files import check_target, write_atomically

if TYPE_CHECKING:
    import pandas as pd


# Fewer corrected rows than this share of a recording, and the model is not for it.
_LEAST_CORRECTED = 0.5
_NOT_JUDGED = "NOT_JUDGED"


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

    A row is corrected, or flagged where the corrector is in doubt, just as in the robot's loop.
    With --rezero-s, each recording begins with truth that sets its zero.
    """
    if output.suffix not in {".csv", ".parquet"}:
        raise RecordingError(f"{output}: call it .csv or .parquet")
    check_target(output, overwrite=force)
    level = options.share(level_percent)
    calibration = truejoint.read_calibration(model)
    inputs = calibration.feature_set
    loaded = files.find(recordings, part=part, model=calibration, inputs=inputs)()
    names = _names(loaded)
    check = data_check.run(loaded, model=calibration, needs_truth=False)
    tables = []
    with progress(f"Correcting {plural(len(loaded), 'recording')}") as done:
        for count, recording in enumerate(loaded, 1):
            at_zero = calibration
            if rezero_s:
                zero = truejoint.calibration.find_zero(calibration, recording, rezero_s)
                at_zero = calibration.at(zero)
            tables.append(correct_rows(at_zero, recording, level, on_fault))
            done(count / len(loaded))
    counts = [_counts(name, table) for name, table in zip(names, tables, strict=True)]
    _write(names, tables, output, force)
    _show(counts, output)
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
    """Time, corrected positions, half-widths and status of every row, by the loop's own kernel.

    An estimator that works on whole recordings only has no such kernel; nothing is judged then.
    """
    import numpy as np
    import pandas as pd

    from truejoint.recordings.table.recording import EPOCH
    from truejoint.runtime.corrector import corrector_for

    start = recording.provenance.start
    t = recording.t + (start if start > EPOCH else 0.0)  # as the file had them, since 1970
    if calibration.family.row is None:
        table = calibration.correct_table(recording, level)
        return table.assign(t=t, status=_NOT_JUDGED)
    calibration.check_recording(recording)
    corrector = corrector_for(calibration, [recording], level=level, on_fault=on_fault)
    corrector.set_homing(True, recording.provenance.homing_id or None)
    trace = corrector.run(recording)
    columns = {"t": t}
    for name, values in (("corrected", trace.position), ("half_width", trace.half_width)):
        columns |= {f"{name}/{joint}": values[:, k] for k, joint in enumerate(calibration.joints)}
    for name, quantity in trace.beside.items():
        joint = calibration.joints[0]
        columns |= {f"{name}/{joint}": quantity[:, 0], f"{name}_half_width/{joint}": quantity[:, 1]}
    bits, place = np.unique(trace.status, return_inverse=True)
    status = np.array([truejoint.runtime.Status(int(b)).name for b in bits], dtype=object)[place]
    return pd.DataFrame(columns).assign(status=status)


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
    return {"recording": name, "rows": len(table), "corrected": corrected, "flagged": counts}


def _write(names: list[str], tables: list[pd.DataFrame], output: Path, force: bool) -> None:
    """One table: of several recordings each row says of which it is."""
    import pandas as pd

    from truejoint.tables import csv_text

    whole = tables[0]
    if len(tables) > 1:
        whole = pd.concat(dict(zip(names, tables, strict=True)), names=["recording", None])
        whole = whole.reset_index("recording")
    if output.suffix == ".parquet":
        truejoint.recordings.write_corrected(whole, output, overwrite=force)
        return
    write = partial(Path.write_text, data=csv_text(whole), encoding="utf-8")
    write_atomically(output, write, overwrite=force, error=RecordingError)


def _show(recordings: list[dict[str, Any]], output: Path) -> None:
    rows = []
    for counts in recordings:
        flagged = ", ".join(f"{n} {status}" for status, n in counts["flagged"].items()) or "-"
        share = f"{100 * counts['corrected'] / counts['rows']:.1f} %"
        rows.append((counts["recording"], f"{counts['rows']}", share, flagged))
    header = ("recording", "rows", "corrected", "in doubt, why")
    print_table(header, rows, title=str(output))
