"""Twins of arms whose joints are driven by cables: what they share."""
