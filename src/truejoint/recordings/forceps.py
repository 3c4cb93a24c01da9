"""Runs of the virtual forceps as recordings, in the shape that a laboratory's would have."""

from __future__ import annotations

import math

from truejoint.recordings.recording import Provenance, Recording
from truejoint.simulation.forceps.twin import ForcepsRun


def record_forceps(run: ForcepsRun, *, specimen: str = "", session: str = "") -> Recording:
    """Turn a run of the forceps into what a laboratory would have of it, and its truth.

    The instrument's name, `specimen`, is for the provenance: a model fitted to one does not fit
    another. Columns: ``measured/jaw`` (the motor's angle seen at the jaw, ``R phi_m / (z_i r)``),
    ``setpoint/jaw``, ``motor/jaw`` [rad], ``cable/drive`` and ``cable/reset`` (``x1`` and ``x2``
    [m], each only where its encoder is installed), ``truth/jaw`` (reference encoder, the paper's
    truth), ``truth_exact/jaw`` (what no laboratory has), ``truth_load/jaw`` (external torque [Nm])
    and the cables' tensions ``truth_tension/drive`` and ``truth_tension/reset`` [N].
    """
    zero, load = run.zero_shift, run.load
    columns = {
        "t": run.t,
        "measured/jaw": run.parameters.mechanism.jaw_from_motor(run.motor),
        "setpoint/jaw": run.setpoint,
        "motor/jaw": run.motor,
        "truth/jaw": run.reference,
        **run.extra,
    }
    provenance = Provenance(
        robot="forceps",
        source=f"virtual forceps {specimen}".rstrip() + f", seed {run.seed}",
        session=session,
        homing_id=f"zero shift: motor {zero.motor * 1e3:.4f} mrad, "
        f"drive {zero.drive * 1e6:.3f} um, reset {zero.reset * 1e6:.3f} um",
        load=0.0 if load is None else load.mass,
        rates={"state": run.log_rate},
        notes=f"load test: {1e3 * load.mass:g} g {load.direction} the motion to "
        f"{math.degrees(load.angle):g} deg"
        if load
        else "",
    )
    return Recording.from_columns(columns, provenance)
