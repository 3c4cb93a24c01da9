"""Runs of the virtual forceps as recordings, in the shape that a laboratory's would have."""

from __future__ import annotations

import math

from truejoint.recordings.recording import Provenance, Recording
from truejoint.simulation.forceps.twin import ForcepsRun


def record_forceps(run: ForcepsRun, *, specimen: str = "", session: str = "") -> Recording:
    """Turn a run of the forceps into what a laboratory would have of it, and its truth.

    Parameters
    ----------
    run : ForcepsRun
    specimen : str
        Name of the instrument, for the provenance; a model fitted to one does not fit another.
    session : str
        Name of the recording session.

    Returns
    -------
    Recording
        Of robot ``forceps``, with columns ``measured/jaw`` (the motor's angle seen at the jaw,
        ``R phi_m / (z_i r)``), ``setpoint/jaw``, ``motor/jaw`` [rad], ``cable/drive`` and
        ``cable/reset`` (``x1`` and ``x2`` [m], each only where its encoder is installed),
        ``truth/jaw`` (reference encoder, the paper's truth), ``truth_exact/jaw`` (what no
        laboratory has), ``truth_load/jaw`` (external torque [Nm]) and the cables' tensions
        ``truth_tension/drive`` and ``truth_tension/reset`` [N].
    """
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
        homing_id=_homing_id(run),
        load=0.0 if run.load is None else run.load.mass,
        rates={"state": run.log_rate},
        notes=_notes(run),
    )
    return Recording.from_columns(columns, provenance)


def _homing_id(run: ForcepsRun) -> str:
    zero = run.zero_shift
    return (
        f"zero shift: motor {zero.motor * 1e3:.4f} mrad, "
        f"drive {zero.drive * 1e6:.3f} um, reset {zero.reset * 1e6:.3f} um"
    )


def _notes(run: ForcepsRun) -> str:
    if run.load is None:
        return ""
    return (
        f"load test: {1e3 * run.load.mass:g} g {run.load.direction} the motion to "
        f"{math.degrees(run.load.angle):g} deg"
    )
