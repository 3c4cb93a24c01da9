"""The HTML report of an evaluation, and the page of several models side by side."""

from truejoint.evaluation.report.page import render_report, write_comparison, write_report

__all__ = ["render_report", "write_comparison", "write_report"]
