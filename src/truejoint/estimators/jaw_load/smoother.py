"""The friction filter, smoothed: for records that are complete, so there is no row."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from truejoint.estimators.jaw_load import run as friction_filter

FAMILY: Final = replace(friction_filter.FAMILY, name="friction_smoother", pack=None, row=None)
