"""Display of the package's values in a terminal, in a notebook and in JSON."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import is_dataclass
from html import escape
from typing import Any


class Summarised:
    """Base of values that show themselves as a few labelled lines, or as a table in a notebook."""

    __slots__ = ()

    @abstractmethod
    def summary(self) -> dict[str, str]:
        """Give what a person wants to know first, by label."""

    def __repr__(self) -> str:
        lines = (f"  {label:<12} {text}" for label, text in self.summary().items())
        return "\n".join([type(self).__name__, *lines])

    def _repr_html_(self) -> str:
        rows = (
            f"<tr><th>{escape(label)}</th><td>{escape(text)}</td></tr>"
            for label, text in self.summary().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{''.join(rows)}</table>"


def json_values(value: Any) -> Any:
    """Give what JSON can hold: None for NaN and infinity, lists for tuples, objects for values."""
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        return {str(key): json_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_values(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy's
        return json_values(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
