"""Measurements of accuracy and speed; see docs/results.md. Nothing here passes or fails."""
