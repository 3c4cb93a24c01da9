"""Published experiments and our own: one shape, one runner, one page.

A study is a line of data (`Study`) and a module that names its parts and makes a summary of them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from truejoint.studies.catalogue import STUDIES, get_study
from truejoint.studies.study import Claim, Option, Part, PartResult, Settings, Study, Summary

if TYPE_CHECKING:
    from truejoint.studies.page import write_study
    from truejoint.studies.runner import StudyResult, run_study

__all__ = [
    "STUDIES",
    "Claim",
    "Option",
    "Part",
    "PartResult",
    "Settings",
    "Study",
    "StudyResult",
    "Summary",
    "get_study",
    "run_study",
    "write_study",
]

# Imported on first use: listing the studies shall not wait for what runs and draws them.
_HOMES = {"StudyResult": "runner", "run_study": "runner", "write_study": "page"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.studies' has no attribute {name!r}")
    return getattr(import_module(f"truejoint.studies.{_HOMES[name]}"), name)
