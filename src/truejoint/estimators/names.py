"""Names of estimators that code above and below the registry asks for; imports nothing."""

from __future__ import annotations

from typing import Final

OFFSET: Final = "offset"  # what errors are given as a percentage of
RAW: Final = "raw"  # the measured position as it is
