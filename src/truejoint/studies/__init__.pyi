from .page import write_overview, write_study
from .runner import StudyResult, run_study
from .study import (
    STUDIES,
    Claim,
    Option,
    Part,
    PartResult,
    Results,
    Settings,
    Statement,
    Study,
    Summary,
    get_study,
)  # fmt: skip

__all__ = [
    "STUDIES", "Claim", "Option", "Part", "PartResult", "Results", "Settings", "Statement", "Study",
    "StudyResult", "Summary", "get_study", "run_study",
    "write_overview", "write_study",
]  # fmt: skip
