"""What the corrector of the loop says of the rows of a test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.calibration import Calibration
from truejoint.errors import CalibrationError
from truejoint.evaluation.results import OFFSET, Domain, Trace
from truejoint.recordings.table.recording import Recording
from truejoint.runtime import Status
from truejoint.runtime.corrector import corrector_for
from truejoint.runtime.limits import believable_corrections

_HOMING = ~int(Status.NOT_HOMED | Status.HOMED_AGAIN)


def loop_status(model: object, recording: Recording) -> Integers | None:
    """`Status` bits (n,) of every row, by the corrector's own kernel; None if it takes no `model`.

    A moved zero is another matter than rows unlike the training, so bits of the homing are left
    out. An estimator that uses later rows runs in no loop; its training domain is judged by alone.
    """
    if not isinstance(model, Calibration) or model.training_domain is None:
        return None
    try:
        corrector = corrector_for(model, [recording])
    except CalibrationError:
        corrector = corrector_for(model.baselines[OFFSET], [recording])
    corrector.set_homing(True)
    return corrector.run(recording).status & _HOMING


def believable(model: object, error: Array) -> Mask | None:
    """Tell in which rows the loop would believe a correction by `error` (n, n_joints) [rad or m].

    That is truth minus measured position; None if no loop takes the `model`.
    """
    if not isinstance(model, Calibration) or model.training_domain is None:
        return None
    lower, upper = believable_corrections(model.training_domain)
    return np.asarray(((error >= lower) & (error <= upper)).all(axis=1))


def domain_of(traces: Sequence[Trace]) -> Domain | None:
    """Say what the loop would correct of the test, why not the rest, and whether truth fits it."""
    known = [trace.status for trace in traces if trace.status is not None]
    fits = [trace.believable for trace in traces if trace.believable is not None]
    if not known or not fits:
        return None
    status = np.concatenate(known)
    shares = {str(bit.name): float(np.mean(status & bit != 0)) for bit in Status if bit}
    found = sorted(((share, name) for name, share in shares.items() if share), reverse=True)
    return Domain(
        inside=float(np.mean(np.concatenate([trace.inside for trace in traces]))),
        flags={name: share for share, name in found},
        beyond=1.0 - float(np.concatenate(fits).mean()),
    )
