"""Judging calibrations: metrics, held-out splits, evaluation, data checks and the report."""

from truejoint.evaluation.checks import DataCheck, Finding, check_data
from truejoint.evaluation.coverage import JointCoverage
from truejoint.evaluation.evaluate import Corrects, JointCalibration, evaluate
from truejoint.evaluation.metrics import max_abs, mean_error, percent_of, rmse, tool_error
from truejoint.evaluation.report import render_report, write_report
from truejoint.evaluation.results import (
    CartesianScore,
    Evaluation,
    IntervalScore,
    JointVerdict,
    RecordingScore,
    Score,
    Stretch,
    Trace,
    Verdict,
    estimator_title,
)
from truejoint.evaluation.splits import part_by_time, split_by_file, split_by_time
from truejoint.evaluation.still import plot_corrected
from truejoint.evaluation.tables import findings_table, interval_table, score_table
from truejoint.evaluation.verdict import judge

__all__ = [
    "CartesianScore",
    "Corrects",
    "DataCheck",
    "Evaluation",
    "Finding",
    "IntervalScore",
    "JointCalibration",
    "JointCoverage",
    "JointVerdict",
    "RecordingScore",
    "Score",
    "Stretch",
    "Trace",
    "Verdict",
    "check_data",
    "estimator_title",
    "evaluate",
    "findings_table",
    "interval_table",
    "judge",
    "max_abs",
    "mean_error",
    "part_by_time",
    "percent_of",
    "plot_corrected",
    "render_report",
    "rmse",
    "score_table",
    "split_by_file",
    "split_by_time",
    "tool_error",
    "write_report",
]
