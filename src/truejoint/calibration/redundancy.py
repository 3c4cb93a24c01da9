"""Parity equations: what holds between a joint's reading and other signals while all are right.

Encoders at the motors, a second encoder of the joint and the set point say, each in its way, where
a joint is. A linear combination of them that stays near zero is a parity equation (Chow and
Willsky, IEEE Transactions on Automatic Control 29(7), 1984); once it does not, one of them is
wrong.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.compatibility import in_all
from truejoint.errors import CalibrationError
from truejoint.features.feature_set import is_signal

if TYPE_CHECKING:
    from truejoint.recordings import Recording

REDUNDANT: Final = ("motor", "driver", "setpoint")
"""Quantities that say where a joint is, beside its measured position."""
_COUPLED: Final = "motor"  # the quantity in which cables couple the joints
_USEFUL: Final = 0.1  # of a joint's range, that an equation may be off by in training at most
_BETTER: Final = 0.1  # of the deviation with the joint's own channel, to bring in other channels
_DROPPED: Final = 1.1  # by what the deviation may grow for a column that is left out
_ROUNDING: Final = 1e-9  # of a joint's range, below which a deviation is rounding
_FITTED_ROWS: Final = 20_000


@dataclass(frozen=True, eq=False)
class ParityEquations:
    """Equations ``matrix @ sample + intercept = 0``, and how far off they were in training."""

    matrix: Array  # (n_equations, n_signals)
    intercept: Array  # (n_equations,) [rad or m]
    lower: Array  # (n_equations,), extremes of the left side over all training rows [rad or m]
    upper: Array
    joint: Array  # (n_equations,), index of the joint that each is about


def redundant_columns(
    recordings: "Sequence[Recording]", asked: Sequence[str] | None = None
) -> dict[str, str]:
    """Give the unit of each column, by name, that is in all recordings and may be redundant.

    Of those `asked` for alone, where they are given; raises CalibrationError if one is none.
    """
    units = recordings[0].units
    there = {
        column: units[column]
        for column in in_all(recordings, units)
        if column.partition("/")[0] in REDUNDANT and is_signal(column)
    }
    wrong = [column for column in asked or () if column not in there]
    if wrong:
        raise CalibrationError(
            f"column {wrong[0]!r:.60} cannot check a measured position; these can, being in "
            f"every recording: {', '.join(there) or 'none'}"
        )
    return there if asked is None else {column: there[column] for column in asked}


def fit_parity_equations(
    recordings: "Sequence[Recording]",
    joints: Sequence[str],
    signals: Sequence[str],
    asked: Sequence[str] | None = None,
) -> tuple[ParityEquations | None, dict[str, str]]:
    """Parity equations of each joint with each quantity among `redundant_columns`.

    Gives them for samples of `signals` followed by the columns that they need, and the units of
    those; None and nothing where no column says where a joint is.
    """
    columns = redundant_columns(recordings, asked)
    tables = {
        name: np.concatenate([recording.column(name) for recording in recordings])
        for name in dict.fromkeys((*columns, *(f"measured/{joint}" for joint in joints)))
    }
    equations = list(_equations(tables, joints, columns))
    if not equations:
        return None, {}
    joint, weights, intercept, rest = zip(*equations, strict=True)
    # By name, as a model file lists them, whatever their order in the recordings is.
    used = sorted(column for column in columns if any(column in each for each in weights))
    names = list(dict.fromkeys((*signals, *used)))
    matrix = np.array([[each.get(name, 0.0) for name in names] for each in weights])
    lower, upper = np.transpose([(r.min(), r.max()) for r in rest])
    parity = ParityEquations(matrix, np.array(intercept), lower, upper, np.array(joint, float))
    return parity, {name: columns[name] for name in names[len(signals) :]}


def _equations(
    tables: Mapping[str, Array], joints: Sequence[str], columns: Mapping[str, str]
) -> Iterator[tuple[int, dict[str, float], float, Array]]:
    """Joint, weights by column, intercept, and the left side at every row, of each equation."""
    varying = [name for name in columns if np.ptp(tables[name]) > 0.0]
    coupled = [name for name in varying if name.startswith(f"{_COUPLED}/")]
    for k, joint in enumerate(joints):
        position = tables[f"measured/{joint}"]
        scale = float(np.ptp(position))
        for quantity in REDUNDANT:
            chosen = [name for name in varying if name == f"{quantity}/{joint}"]
            if quantity == _COUPLED and coupled:
                chosen = _chosen_columns(tables, position, chosen, coupled, _ROUNDING * scale)
            if not chosen:
                continue
            coef, intercept, rest = _regress(tables, position, chosen)
            if np.ptp(rest) <= _USEFUL * scale:
                weights = {f"measured/{joint}": 1.0} | {n: -c for n, c in coef.items()}
                yield k, weights, -intercept, rest


def _chosen_columns(
    tables: Mapping[str, Array], position: Array, own: list[str], same: list[str], rounding: float
) -> list[str]:
    """Columns of the joint's own channel, or of as many as it takes where cables are coupled."""

    def deviation(names: list[str]) -> float:
        return max(float(np.std(_regress(tables, position, names)[2])), rounding)

    least = deviation(same)
    if least > _BETTER * deviation(own):
        return own
    chosen = list(same)
    for name in same:
        rest = [other for other in chosen if other != name]
        if deviation(rest) <= _DROPPED * least:
            chosen = rest
    return chosen


def _regress(
    tables: Mapping[str, Array], position: Array, names: list[str]
) -> tuple[dict[str, float], float, Array]:
    """Coefficient of each column and intercept, by least squares, and what they leave (n,)."""
    some = slice(None, None, len(position) // _FITTED_ROWS + 1)
    X = np.column_stack([np.ones(len(position[some])), *(tables[n][some] for n in names)])
    middle, spread = X.mean(axis=0), X.std(axis=0)
    middle[0], spread[0] = 0.0, 1.0
    weights = np.linalg.lstsq((X - middle) / spread, position[some], rcond=None)[0] / spread
    intercept = float(weights[0] - middle[1:] @ weights[1:])
    coef = dict(zip(names, weights[1:].tolist(), strict=True))
    fitted = sum((c * tables[n] for n, c in coef.items()), np.zeros(len(position)))
    return coef, intercept, position - fitted - intercept
