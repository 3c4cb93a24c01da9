"""The data check on the command line: what was found is told, and what failed ends the command."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import truejoint
from truejoint.cli.console import err, progress
from truejoint.errors import RecordingError, unknown
from truejoint.recordings.judge.finding import FINDINGS

CHECK_FAILED: Final = 1


def check_names(accepted: Sequence[str] | None) -> tuple[str, ...]:
    """Names given to ``--accept``; raises RecordingError for one that no finding has."""
    for name in accepted or ():
        if name not in FINDINGS:
            raise RecordingError(f"--accept {unknown('finding', name, FINDINGS)}")
    return tuple(accepted or ())


def checked(
    recordings: Sequence[truejoint.Recording], accepted: Sequence[str], **how: Any
) -> truejoint.recordings.DataCheck:
    """Check recordings as `check_data` does and say what was found, but for mere information."""
    with progress(f"Checking {len(recordings)} recording{'s'[: len(recordings) != 1]}"):
        check = truejoint.recordings.check_data(recordings, **how).accept(accepted)
    for finding in check.findings:
        if finding.level != "info":
            evidence = f"{finding.where}: {finding.what}; {finding.advice}"
            went_on = finding.level == "fail" and finding.name in check.accepted
            level = "accepted" if went_on else finding.level
            err.print(f"{level}: {finding.name}: {evidence}", soft_wrap=True)
    return check


def say_failed(check: truejoint.recordings.DataCheck) -> None:
    """Name in one line what failed, if anything did, and how to go on all the same."""
    if not check.failed:
        return
    names = check.failures
    accept = " ".join(f"--accept {name}" for name in names)
    failed = f"the data check failed ({', '.join(names)}): mend the data, or go on with {accept}"
    err.print(f"truejoint: {failed}", style="red", soft_wrap=True)
