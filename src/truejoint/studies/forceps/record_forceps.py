"""Runs of the virtual forceps as recordings, in the shape that a laboratory's would have."""

from __future__ import annotations

import math
from dataclasses import replace

from numpy.typing import ArrayLike

from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.twin import ZeroShift, simulate_forceps


def record_forceps(
    parameters: ForcepsParameters,
    motion: ArrayLike | LoadTest,
    *,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift = ZeroShift(),  # noqa: B008  # frozen
    specimen: str = "",
    session: str = "",
) -> Recording:
    """Record a motion of the virtual forceps: what a laboratory would have of it, and its truth.

    Arguments, and what is raised, are those of `simulate_forceps`; `specimen` names the instrument
    and `session` the recording session, for the provenance.

    Columns are ``measured/jaw`` (the motor's angle seen at the jaw, ``R phi_m / (z_i r)``),
    ``setpoint/jaw``, ``motor/jaw`` [rad], ``cable/drive`` and ``cable/reset`` (``x1`` and ``x2``
    [m], each only where its encoder is installed), ``truth/jaw`` (reference encoder, the paper's
    truth), ``truth_exact/jaw`` (what no laboratory has), ``truth_load/jaw`` (external torque [Nm])
    and the cables' tensions ``truth_tension/drive`` and ``truth_tension/reset`` [N].
    """
    run = simulate_forceps(parameters, motion, seed=seed, log_rate=log_rate, zero_shift=zero_shift)
    columns = {
        "t": run.t,
        "measured/jaw": run.measured[:, 0],
        "setpoint/jaw": run.setpoint[:, 0],
        "motor/jaw": run.motor[:, 0],
        "truth/jaw": run.truth.position[:, 0],
        **run.extra,
    }
    mass, notes = 0.0, ""
    if isinstance(motion, LoadTest):
        mass, angle = motion.mass, math.degrees(motion.angle)
        notes = f"load test: {1e3 * mass:g} g {motion.direction} the motion to {angle:g} deg"
    provenance = Provenance(
        robot="forceps",
        source=f"virtual forceps {specimen}".rstrip() + f", seed {seed}",
        session=session,
        homing_id=f"zero shift: motor {zero_shift.motor * 1e3:.4f} mrad, "
        f"drive {zero_shift.drive * 1e6:.3f} um, reset {zero_shift.reset * 1e6:.3f} um",
        load=mass,
        rates={"state": 1.0 / float(run.t[1] - run.t[0])},
        notes=notes,
    )
    robot = replace(
        get_robot("forceps"), mechanism=parameters.mechanism.mechanism(), transmission=None
    )
    return Recording.from_columns(columns, provenance, robot=robot)
