"""The data check on the command line: what was found is told, and what failed ends the command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import truejoint
from truejoint.cli.console import err, plural, progress
from truejoint.errors import RecordingError, unknown
from truejoint.recordings.judge.finding import FINDINGS


@dataclass(frozen=True)
class DataCheck:
    """Findings of the data check that are accepted, an option for each."""

    accept: list[str] | None = None

    def __post_init__(self) -> None:
        for name in self.accept or ():
            if name not in FINDINGS:
                raise RecordingError(f"--accept {unknown('finding', name, FINDINGS)}")

    def run(
        self, recordings: Sequence[truejoint.Recording], **how: Any
    ) -> truejoint.recordings.DataCheck:
        """Check recordings as `check_data` does and say what was found, but for information."""
        with progress(f"Checking {plural(len(recordings), 'recording')}"):
            check = truejoint.recordings.check_data(recordings, **how).accept(self.accept or ())
        for finding in check.findings:
            if finding.level != "info":
                evidence = f"{finding.where}: {finding.what}; {finding.advice}"
                went_on = finding.level == "fail" and finding.name in check.accepted
                level = "accepted" if went_on else finding.level
                err.print(f"{level}: {finding.name}: {evidence}", soft_wrap=True)
        return check


def say_failed(check: truejoint.recordings.DataCheck) -> None:
    """Name in one line what failed, if anything did, and how to go on all the same."""
    if check.failed:
        names = check.failures
        accept = " ".join(f"--accept {name}" for name in names)
        failed = f"the data check failed ({', '.join(names)}): mend the data, or go on with"
        err.print(f"truejoint: {failed} {accept}", style="red", soft_wrap=True)
