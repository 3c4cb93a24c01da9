"""Runs of a virtual wrist as recordings, in the shape that a laboratory's would have."""

from __future__ import annotations

from numpy.typing import ArrayLike

from truejoint.errors import TruejointError
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.simulation.wrist.twin import WristTwin


def record_wrist(
    twin: WristTwin, setpoint: ArrayLike, *, log_rate: float = 200.0, session: str = ""
) -> Recording:
    """Record a homed twin along set-points (n, n_joints) [rad] at 1 kHz, a row at `log_rate` [Hz].

    Columns are ``measured``, ``effort``, ``motor`` and ``truth`` of every joint, tensions where
    they are measured, and what no laboratory has: ``truth_exact`` of the joints and ``truth_load``,
    torques [Nm] of grip and tip. Raises what `WristTwin.run` does, and TruejointError unless the
    rate is above 0.
    """
    if not log_rate > 0.0:
        raise TruejointError(f"a log rate of {log_rate} Hz; it must be above 0")
    run = twin.run(setpoint)
    every = max(1, round(1.0 / (SETPOINT_DT * log_rate)))
    columns = {"t": run.t, **run.columns()}
    columns |= {f"truth/{name}": run.truth.position[:, k] for k, name in enumerate(run.truth.name)}
    provenance = Provenance(
        robot=twin.robot.name,
        arm=twin.robot.arm,
        source=f"virtual wrist, seed {twin.seed}",
        session=session,
        homing_id=f"seed {twin.seed}, homing {twin.homing_count}",
        load=twin.load,
        rates={"state": 1.0 / (every * SETPOINT_DT)},
    )
    return Recording.from_columns({k: v[::every] for k, v in columns.items()}, provenance)
