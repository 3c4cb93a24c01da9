from .catalogue import STUDIES, get_study
from .overview import write_overview
from .page import write_study
from .runner import StudyResult, run_study
from .study import Claim, Option, Part, PartResult, Results, Settings, Statement, Study, Summary

__all__ = [
    "STUDIES", "Claim", "Option", "Part", "PartResult", "Results", "Settings", "Statement", "Study",
    "StudyResult", "Summary", "get_study", "run_study",
    "write_overview", "write_study",
]  # fmt: skip
