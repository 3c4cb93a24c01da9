"""Every study by name."""

from __future__ import annotations

from typing import Final

from truejoint.errors import StudyError, unknown
from truejoint.studies import forceps
from truejoint.studies.study import Study

STUDIES: Final = {study.name: study for study in forceps.STUDIES}
"""In the order in which they are listed."""


def get_study(name: str) -> Study:
    """Study called `name`; raises StudyError naming those that there are.

    Examples
    --------
    >>> get_study("forceps-unloaded").source
    'yan2020, Table 2, figures 6 and 7'
    """
    if name not in STUDIES:
        raise StudyError(unknown("study", name, STUDIES))
    return STUDIES[name]
