"""Which dimples to touch, in which order, and from which sides."""

from __future__ import annotations

from itertools import combinations, product
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.tip.rows import TipPrior, TipRows

_IMPROVEMENTS: Final = 20  # passes of shortening the way


def choose_touches(rows: TipRows, prior: TipPrior, count: int) -> Integers:
    """Choose `count` of the rows, one by one, whose points tell most of what is not known.

    Each adds most to the determinant of the parameters' information (D-optimal: Atkinson, Donev and
    Tobias, Optimum Experimental Designs, with SAS, 2007, ch. 12). Gives their places (count,), the
    most telling first. Raises CalibrationError if there are fewer rows.
    """
    if not 0 < count <= len(rows):
        raise CalibrationError(
            f"{count} touches of {len(rows)} dimples in reach; choose fewer, or print a larger one"
        )
    free = np.flatnonzero(prior.free)
    equations = rows.equations(prior.state)
    whitening = equations.whitening(rows.joint_sd, np.array(rows.point_sd))
    jacobian = (whitening @ equations.by_parameter)[:, :, free]
    # A little of everything is known, so that the first touches count for something.
    size = np.einsum("mia,mia->a", jacobian, jacobian) + np.diag(prior.precision)[free]
    known = prior.precision[np.ix_(free, free)] + 1e-6 * np.diag(size)
    covariance = np.linalg.inv(known)
    left, chosen = list(range(len(rows))), []
    for _ in range(count):
        spread = jacobian[left] @ covariance @ jacobian[left].transpose(0, 2, 1)
        gain = np.linalg.slogdet(np.eye(3) + spread)[1]
        best = left.pop(int(np.argmax(gain)))
        chosen.append(best)
        own = jacobian[best]
        inner = np.linalg.inv(np.eye(3) + own @ covariance @ own.T)
        covariance = covariance - covariance @ own.T @ inner @ own @ covariance
    return np.array(chosen)


def shortest_order(joint: Array, speed: Array, first: int = 0) -> Integers:
    """Order (m,) in which positions (m, n) are gone through in little time, beginning with `first`.

    The slowest joint decides how long a way takes, at its `speed` (n,) [rad/s or m/s]. The nearest
    next, then parts of the way turned round and single stops moved while that shortens it (2-opt
    and or-opt: Croes, Operations Research 6(6), 1958; Or, thesis, Northwestern University, 1976).
    """
    apart = (np.abs(joint[:, None] - joint[None]) / speed).max(axis=2)

    def way(order: list[int]) -> float:
        return float(apart[order[:-1], order[1:]].sum())

    left, order = set(range(len(joint))) - {first}, [first]
    while left:
        order.append(min(left, key=lambda k: (apart[order[-1], k], k)))
        left.remove(order[-1])
    for _ in range(_IMPROVEMENTS):
        before = way(order)
        for i, j in combinations(range(1, len(order)), 2):
            part = order[i : j + 1]
            for other in (part[::-1], [*part[1:], part[0]], [part[-1], *part[:-1]]):
                changed = [*order[:i], *other, *order[j + 1 :]]
                if way(changed) < way(order) - 1e-9:
                    order = changed
        if not way(order) < before:
            break
    return np.array(order)


def approach_sides(count: int, n_joints: int, seed: int = 0) -> Array:
    """Sides (count, n_joints) of -1 and 1 from which each joint comes: all combinations in turn.

    Each joint comes from either side half of the time, and no joint always with another.
    """
    every = np.array(list(product((-1.0, 1.0), repeat=n_joints)))
    rng = np.random.default_rng([seed, 61])
    turns = [rng.permutation(len(every)) for _ in range(-(-count // len(every)))]
    return np.asarray(every[np.concatenate(turns)[:count]])
