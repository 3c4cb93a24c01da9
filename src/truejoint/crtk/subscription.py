"""One subscriber of an arm's blocks, in pieces of the length that it asked for."""

from __future__ import annotations

from dataclasses import dataclass, field

from truejoint.crtk.protocol import Listener
from truejoint.robots.blocks import StateBlock, TruthBlock


@dataclass(eq=False)
class Subscription:
    """Calls `callback` with blocks that span up to `every` seconds, the states first."""

    callback: Listener
    every: float
    _states: list[StateBlock] = field(default_factory=list)
    _truths: list[TruthBlock] = field(default_factory=list)

    def __call__(self, block: StateBlock | TruthBlock) -> None:
        """Deliver a block, or keep it until there is enough."""
        if self.every <= 0.0:
            self.callback(block)
            return
        if isinstance(block, TruthBlock):
            self._truths.append(block)
            return
        # A truth that came with an earlier state is delivered with it.
        if self._states and block.t.size and block.t[-1] - self._states[0].t[0] > self.every:
            self.flush()
        self._states.append(block)

    def flush(self) -> None:
        """Deliver what is kept."""
        states, self._states = self._states, []
        truths, self._truths = self._truths, []
        if states:
            self.callback(StateBlock.joined(states))
        if truths:
            self.callback(TruthBlock.joined(truths))
