"""Faults put into any back end, to try what is to survive them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, get_args

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.limits import checked_backend
from truejoint.crtk.protocol import STRETCH, Backend, Listener
from truejoint.crtk.states import OperatingState, StateCommand
from truejoint.errors import CommandRefused, RobotError
from truejoint.robots.blocks import StateBlock, TruthBlock, in_grains

FaultKind = Literal["fault", "pause", "link", "silence", "slip"]
FAULTS: Final[tuple[FaultKind, ...]] = get_args(FaultKind)


@dataclass(frozen=True)
class Fault:
    """What goes wrong, and when."""

    kind: FaultKind
    t: float
    joint: str = ""
    size: float = 0.0


class FaultyBackend:
    """Another back end, with faults, that is sent motions as a real one is."""

    stretch = STRETCH

    def __init__(self, backend: Backend, faults: Sequence[Fault]) -> None:
        checked_backend(backend)
        for fault in faults:
            if fault.kind not in FAULTS:
                raise RobotError(f"no fault {fault.kind!r:.40}; use one of {', '.join(FAULTS)}")
            if fault.kind == "slip":
                backend.robot.joint(fault.joint)
        self._backend: Final = backend
        self._faults = tuple(faults)
        self._cleared = False
        self._listener: Listener = lambda _: None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._backend, name)

    def connect(self, listener: Listener) -> None:
        """Deliver all blocks that the faults let pass."""
        before, self._listener = self._listener, listener
        try:
            self._backend.connect(self._pass_on)
        except BaseException:
            self._listener = before
            raise

    def operating_state(self) -> OperatingState:
        """State as the robot reports it, FAULT or PAUSED by then."""
        now = self._backend.operating_state()
        if self._has("fault") and not self._cleared:
            return replace(now, state="FAULT")
        if self._has("pause") and not self._cleared and now.state == "ENABLED":
            return replace(now, state="PAUSED")
        return now

    def state_command(self, command: StateCommand, timeout: float) -> None:
        """Carry out a state command; ``disable`` clears a fault, ``resume`` a pause."""
        self._check_link(command)
        if command in ("disable", "resume"):
            self._cleared = True
        self._backend.state_command(command, timeout)

    def servo_jp(self, position: Array, go_on: Callable[[], bool]) -> int:
        """Stream set-points (n, n_joints) [rad or m] until there is a fault or the link is lost."""
        taken = 0
        for piece in in_grains(position, max(round(self.grain * self.rate), 1)):
            self._check_link("servo_jp")
            if not self.operating_state().is_ready:
                break
            taken += self._backend.servo_jp(piece, go_on)
        return taken

    def _check_link(self, command: str) -> None:
        if self._has("link"):
            raise CommandRefused(f"{command} refused: the link to {self.robot.title} is lost")

    def _has(self, kind: FaultKind) -> bool:
        return any(fault.kind == kind and self.time >= fault.t for fault in self._faults)

    def _pass_on(self, block: StateBlock | TruthBlock) -> None:
        if self._has("silence") or self._has("link"):
            return
        if isinstance(block, StateBlock):
            measured = block.measured.copy()
            for fault in self._faults:
                if fault.kind == "slip":
                    column = self.robot.channels.index(fault.joint)
                    measured[:, column] += np.where(block.t >= fault.t, fault.size, 0.0)
            block = replace(block, measured=measured)
        self._listener(block)
