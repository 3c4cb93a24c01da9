"""A homed arm on a twin for tracking studies, and the signals that only the twin tells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk import Arm
from truejoint.crtk.backends.simulated import SimulatedBackend
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.simulation.twin import Twin


def homed_arm(twin: Any) -> Arm:
    """Enable and home an arm on a twin."""
    arm = Arm(SimulatedBackend(cast("Twin", twin)))
    arm.enable()
    arm.home()
    return arm


class TwinSignals:
    """Columns (n, k) that an arm on a twin tells beside its state, such as ``truth_exact/jaw``.

    ``truth/...`` is what a temporary sensor at that joint reads, at times of its own.
    """

    def __init__(self, arm: Arm, columns: Sequence[str]) -> None:
        self._columns = columns
        self._rows: dict[str, list[Array]] = {name: [] for name in columns}
        arm.subscribe(self)

    def __call__(self, block: StateBlock | TruthBlock) -> None:
        """Store the rows of a block."""
        for name, rows in self._rows.items():
            quantity, joint = name.split("/")
            if isinstance(block, TruthBlock) and quantity == "truth":
                rows.append(block.position[:, block.name.index(joint)])
            elif isinstance(block, StateBlock) and quantity != "truth":
                rows.append(block.extra[name])

    def values(self, column: str) -> Array:
        """Rows (n,) of a column since the start."""
        return np.concatenate(self._rows[column])
