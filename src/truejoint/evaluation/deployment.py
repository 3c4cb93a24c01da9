"""Which of the models that were judged belongs on the robot."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.evaluation.paired_test import compare, simplest
from truejoint.evaluation.results import OFFSET, RAW, Trace

PLAIN: Final = frozenset({RAW, OFFSET, "linear"})
"""What needs no proof that it is better than something simpler."""


def to_deploy(traces: Sequence[Trace], plain: Collection[str] = PLAIN) -> str:
    """Name the best of the `plain` estimators, unless a richer one beats it beyond chance.

    It does over all recordings together, or in each by itself: where one shows a larger difference
    than another, that is no doubt of either. Counted are the rows that the loop would correct (all,
    where there are none), each by its error as a multiple of the fixed offset's in that joint. Of
    richer ones that do and cannot be told apart, the first named is the one.

    Parameters
    ----------
    traces : sequence of Trace
        Of one or more evaluations of the same estimators.
    plain : collection of str
        Estimators that need no proof.

    Raises
    ------
    CalibrationError
        If there are no traces.

    Examples
    --------
    >>> to_deploy(evaluation.traces)
    'linear'
    """
    if not traces:
        raise CalibrationError("there is no evaluation to choose by; give the traces of one")
    rows = [trace.inside for trace in traces]
    if sum(map(np.sum, rows)) < 2:
        rows = [np.ones(len(trace.t), dtype=bool) for trace in traces]
    errors = {
        name: [trace.error(name)[row] for trace, row in zip(traces, rows, strict=True)]
        for name in traces[0].estimates
    }
    scale = np.sqrt(np.mean(np.concatenate(errors[OFFSET]) ** 2, axis=0))
    scale[scale == 0.0] = 1.0
    scaled = {
        name: [error / scale for error in scaled_errors] for name, scaled_errors in errors.items()
    }
    size = {
        name: sum(float(np.sum(e**2)) for e in scaled_errors)
        for name, scaled_errors in scaled.items()
    }
    best = min((name for name in scaled if name in plain), key=lambda name: size[name])
    richer = {
        name: scaled_errors
        for name, scaled_errors in scaled.items()
        if name not in plain and _beats(scaled_errors, scaled[best])
    }
    return simplest(richer) if richer else best


def _beats(errors: Sequence[Array], other: Sequence[Array]) -> bool:
    """Whether errors are smaller beyond chance: of all recordings, or of each that has rows."""
    pairs = [([a], [b]) for a, b in zip(errors, other, strict=True) if len(a)]
    return compare(errors, other).outcome == "better" or all(
        compare(*pair).outcome == "better" for pair in pairs
    )
