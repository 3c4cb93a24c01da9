"""Display of the package's values in a terminal, in a notebook and in JSON."""

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

from truejoint.errors import meant

_GUESSES: Final = {
    **dict.fromkeys(("fit", "train"), "truejoint.calibrate(recordings)"),
    **dict.fromkeys(("load", "read", "read_csv"), "read_recording(path) or read_calibration(path)"),
    **dict.fromkeys(("evaluate", "score"), "truejoint.evaluate(model, recordings)"),
    **dict.fromkeys(("correct", "predict", "update"), "truejoint.Corrector(model).step(t, sample)"),
    **dict.fromkeys(("UnscentedKalmanFilter", "UnscentedFilter"), "truejoint.UKF"),
}


class Summarised:
    """Base of values that show themselves as a few labelled lines, or as a table in a notebook."""

    __slots__ = ()

    if not TYPE_CHECKING:  # a type checker would then let any name pass

        def __getattr__(self, name: str) -> Any:
            kind = type(self)
            if hasattr(kind, name):  # a property that failed says why
                return object.__getattribute__(self, name)
            names = [public for public in dir(kind) if public[0] != "_" != name[0]]
            raise AttributeError(f"{kind.__name__} has no {name!r}{instead(name, names)}")

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


def instead(name: str, choices: Iterable[str]) -> str:
    """Say after a semicolon what does what a name that does not exist may stand for."""
    known = f" use {_GUESSES[name]}" if name in _GUESSES else meant(name, choices)
    return ";" * bool(known) + known


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
