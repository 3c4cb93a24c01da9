"""Faults put into any back end, to try what is to survive them."""

from dataclasses import dataclass, replace

import numpy as np

from truejoint.crtk.protocol import STRETCH
from truejoint.errors import CommandRefused
from truejoint.robots.blocks import StateBlock


@dataclass(frozen=True)
class Fault:
    """What goes wrong (a fault, pause, lost link, silence or slip), and when [s]."""

    kind: str
    t: float
    joint: str = ""
    size: float = 0.0


class FaultyBackend:
    """Another back end, with faults, that is sent motions as a real one is."""

    stretch = STRETCH

    def __init__(self, backend, faults):
        self._backend, self._faults = backend, faults
        self._cleared = False

    def __getattr__(self, name):
        return getattr(self._backend, name)

    def connect(self, listener):
        self._listener = listener
        self._backend.connect(self._pass_on)

    def operating_state(self):
        now = self._backend.operating_state()
        if self._has("fault") and not self._cleared:
            return replace(now, state="FAULT")
        if self._has("pause") and not self._cleared and now.state == "ENABLED":
            return replace(now, state="PAUSED")
        return now

    def state_command(self, command, timeout):
        """Carry it out; ``disable`` clears a fault, ``resume`` a pause."""
        self._check_link(command)
        if command in ("disable", "resume"):
            self._cleared = True
        self._backend.state_command(command, timeout)

    def servo_jp(self, position, go_on):
        """Stream set-points until there is a fault or the link is lost."""
        taken, size = 0, max(round(self.grain * self.rate), 1)
        for piece in (position[k : k + size] for k in range(0, len(position), size)):
            self._check_link("servo_jp")
            if not self.operating_state().is_ready:
                break
            taken += self._backend.servo_jp(piece, go_on)
        return taken

    def _check_link(self, command):
        if self._has("link"):
            raise CommandRefused(f"{command} refused: the link to {self.robot.title} is lost")

    def _has(self, kind):
        return any(fault.kind == kind and self.time >= fault.t for fault in self._faults)

    def _pass_on(self, block):
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
