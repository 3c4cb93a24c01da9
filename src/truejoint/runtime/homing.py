"""Whether the positions of a robot still refer to the homing that it was calibrated after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from truejoint.runtime.status import Status


class Homing:
    """What is known of a robot's homing, against that of the calibration with these metadata.

    Their ``homing_ids`` are those of the training recordings or, where it was ``rezeroed`` since,
    that of the truth it was re-zeroed to. `status` is OK, NOT_HOMED or HOMED_AGAIN, `rezeroed`
    whether an offset was found for the present homing.
    """

    def __init__(self, metadata: Mapping[str, Any]) -> None:
        ids = metadata.get("homing_ids", ())
        named = ids if isinstance(ids, (list, tuple)) else ()
        self._known = {name for name in named if isinstance(name, str)}
        self._id: str | None = None
        self._was_lost = False
        self._zeroed = "rezeroed" in metadata
        self.status = Status.NOT_HOMED
        self.rezeroed = False

    def tell(self, is_homed: bool, homing_id: str | None) -> bool:
        """Take over what the robot says; returns whether its positions may have shifted."""
        before = self.status, self._id
        if not is_homed:
            self._was_lost = True
            self.status, self._id = Status.NOT_HOMED, None
        elif homing_id is None:
            self.status = Status.HOMED_AGAIN if self._was_lost else Status.OK
        else:
            if not self._known:
                self._known.add(homing_id)
            fits = homing_id in self._known
            self._was_lost = not fits
            self.status = Status.OK if fits else Status.HOMED_AGAIN
            self._id = homing_id
        changed = (self.status, self._id) != before
        own_zero = self._zeroed and self.status == Status.OK
        self.rezeroed = own_zero or (self.rezeroed and not changed)
        return changed

    def accept(self) -> None:
        """Let the present homing count as that of the calibration."""
        if self.status == Status.NOT_HOMED:
            return
        if self._id is not None:
            self._known.add(self._id)
        self._was_lost = False
        self.status = Status.OK
        self.rezeroed = True
