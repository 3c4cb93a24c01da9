"""The HTML report of an evaluation."""

from truejoint.evaluation.report.page import render_report, write_report

__all__ = ["render_report", "write_report"]
