"""What a value of the package shows of itself in a terminal and in a notebook."""

from __future__ import annotations

from abc import abstractmethod
from html import escape


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
