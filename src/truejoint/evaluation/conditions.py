"""Conditions of a test that lie beyond all that a model has learnt from."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final, cast

import pandas as pd
from pandas import DataFrame

from truejoint.calibration.conditions import Condition
from truejoint.toml_file import shipped_table
from truejoint.units import shown, shown_range

_FACTOR: Final = 1.25  # beyond the least and the largest that were learnt, of what is a size
_SHIFT: Final = 0.25  # of the shortest range that was learnt, beyond the middles that were learnt
_SLOPE: Final = 0.02  # beyond the slopes that were learnt
_NAMED: Final = 3  # recordings
_WORDS: Final = shipped_table(__package__, "words.toml")["beyond"]


def unlike(
    learnt: Sequence[Condition], tested: Mapping[str, Sequence[Condition]], units: Mapping[str, str]
) -> Iterator[str]:
    """Say which conditions of recordings, by their names, lie beyond all that were learnt.

    `units` are those of the columns ``measured/<joint>`` and ``effort/<joint>``.
    """
    least, most = _ends(learnt)
    low, high = least / _FACTOR, most * _FACTOR
    margins: dict[str, Any] = {"middle": _SHIFT * least["range"], "slope": _SLOPE}
    for kind, margin in margins.items():
        low[kind], high[kind] = least[kind] - margin, most[kind] + margin
    frames = {name: DataFrame(list(each)).set_index("joint") for name, each in tested.items()}
    values, ranges = pd.concat(frames, names=["recording"]), learnt_texts(learnt, units)
    for joint, kind in product(least.index.intersection(values.index.unique("joint")), _WORDS):
        column, at = values.xs(joint, level="joint")[kind], (joint, kind)
        sides = column[column < low.at[at]], column[column > high.at[at]]
        for words, beyond in zip(_WORDS[kind], sides, strict=True):
            names = ", ".join(map(str, beyond.index[:_NAMED]))
            if len(beyond) > _NAMED:
                names += f" and {len(beyond) - _NAMED} more"
            if names:
                text = _range_text([beyond.min(), beyond.max()], kind, joint, units)
                learnt_text = ranges[f"{kind} of {joint}"]
                yield f"{joint} {words} than in training in {names}: {text}, learnt {learnt_text}."


def learnt_texts(learnt: Sequence[Condition], units: Mapping[str, str]) -> dict[str, str]:
    """Say the range of each condition that was learnt, by joint and condition."""
    least, most = _ends(learnt)
    return {
        f"{kind} of {joint}": _range_text([least.at[joint, kind], high], kind, joint, units)
        for joint, kind in product(least.index, _WORDS)
        if math.isfinite(high := cast("float", most.at[joint, kind]))
    }


def _ends(learnt: Sequence[Condition]) -> tuple[DataFrame, DataFrame]:
    """Least and largest of each condition, by joint."""
    known = DataFrame(list(learnt), columns=["joint", *_WORDS]).groupby("joint", sort=False)
    return known.min(), known.max()


def _range_text(ends: Sequence[Any], kind: str, joint: str, units: Mapping[str, str]) -> str:
    (low, high), quantity = map(float, ends), "effort" if kind == "effort" else "measured"
    unit = units.get(f"{quantity}/{joint}", "")
    unit = {"speed": f"{unit}/s", "slope": ""}.get(kind, unit)
    return (shown_range(low, high, unit) if low < high else shown(low, unit)).strip()
