"""What the page shows of samples: poses, curves over time, and HTML; no browser in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Final

import jinja2
import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Panel
from truejoint.monitor.samples import Condition, Samples
from truejoint.robots import Robot
from truejoint.runtime.status import Status
from truejoint.units import display_unit

POSES: Final = ("reported", "corrected", "truth")
TITLES: Final = {
    "setpoint": "commanded", "reported": "reported", "corrected": "corrected", "truth": "true",
}  # fmt: skip
# Legible on white and on black, and distinct under every common colour blindness.
COLOURS: Final = {
    "setpoint": "#8b949e", "reported": "#e07b00", "corrected": "#2f81d8", "truth": "#12a074",
    "band": "rgba(47,129,216,0.22)", "stale": "#9aa0a6",
    "fault": "#d1242f",
}  # fmt: skip

_LATE: Final = 1.0  # [s]

PLOTS: Final = ("position", "correction", "effort", "messages")


def poses(samples: Samples, robot: Robot) -> dict[str, Array]:
    """Joint positions (n_joints,) [rad or m] of the latest row, by which they are of.

    A joint that is not corrected, or has no sensor, stands where it is reported. What is known of
    no joint is left out; without the reported position of every joint there is no pose at all.

    Examples
    --------
    >>> samples = Samples.of_recording(test, model)
    >>> sorted(poses(samples, test.robot))
    ['corrected', 'reported', 'truth']
    """
    if samples.joints != robot.joint_names:
        return {}
    reported, shown = samples.reported[-1], {}
    for name in POSES:
        values = getattr(samples, name)[-1]
        if np.isfinite(values).any():
            shown[name] = np.where(np.isfinite(values), values, reported)
    return shown


def plots(samples: Samples, robot: Robot, joint: str) -> dict[str, Panel]:
    """Give the plots of one joint, of `PLOTS` those of which something is known, by name.

    Examples
    --------
    >>> sorted(plots(Samples.of_recording(test, model), test.robot, "jaw"))
    ['correction', 'effort', 'messages', 'position']
    """
    k, unit = samples.joints.index(joint), display_unit(robot.joint(joint).unit)
    reported, truth = samples.reported[:, k], samples.truth[:, k]
    correction, width = samples.corrected[:, k] - reported, samples.half_width[:, k]

    def curve(label: str, colour: str, values: Array) -> Curve:
        return Curve(samples.t, values, label, COLOURS[colour])

    bounds = [curve("", "band", unit.scale * (correction + side * width)) for side in (1, -1)]
    errors = [
        curve("corrected - reported", "corrected", unit.scale * correction),
        curve("true - reported", "truth", unit.scale * (truth - reported)),
    ]
    curves = {
        f"{joint} [{unit.name}]": [
            curve(title, name, unit.scale * getattr(samples, name)[:, k])
            for name, title in TITLES.items()
        ],
        f"error of {joint} [{unit.name}]": (bounds if np.isfinite(width).any() else []) + errors,
        f"effort of {joint} [{samples.effort_units[k]}]": [
            curve("reported", "reported", samples.effort[:, k])
        ],
        "between state messages [ms]": [
            curve("longest interval", "setpoint", 1e3 * samples.interval)
        ],
    }
    panels = {
        name: Panel(_finite(lines, samples.t), y=title)
        for name, (title, lines) in zip(PLOTS, curves.items(), strict=True)
    }
    return {name: panel for name, panel in panels.items() if panel.curves}


def _finite(curves: Sequence[Curve], t: Array) -> list[Curve]:
    """Leave out curves of which nothing was known of late, then rows where one is missing.

    The plots can draw no gap: a single NaN empties them.
    """
    late = t > t[-1] - _LATE
    recent = [curve for curve in curves if np.isfinite(np.asarray(curve.y)[late]).any()]
    rows = np.ones(len(t), dtype=bool)
    for curve in recent:
        rows &= np.isfinite(curve.y)
    return [replace(c, x=t[rows], y=np.asarray(c.y)[rows]) for c in recent] if rows.any() else []


def status_html(condition: Condition, samples: Samples | None) -> str:
    """Say how the arm stands: state, why, clock, and what the corrector says."""
    colour = COLOURS["truth" if not condition.reason else "reported"]
    if condition.state in ("FAULT", "no answer"):
        colour = COLOURS["fault"]
    if samples is None:
        return filled("status", colour, condition, None, "", "")
    t, age = float(samples.t[-1]), ""
    if not condition.is_fresh and (seconds := condition.t - t) > 0.0:
        age = f"{seconds:.1f} s" if seconds < 60.0 else f"{seconds / 60.0:.0f} min"
    words = Status(int(samples.status[-1]))
    return filled("status", colour, condition, t, age, words.words if words else "")


def table_html(samples: Samples, robot: Robot, *, is_fresh: bool) -> str:
    """Table of the latest row, a joint a line, of what was known of late; grey if not of now.

    Examples
    --------
    >>> "0.2" in table_html(Samples.of_recording(test, model), test.robot, is_fresh=True)
    True
    """
    columns = [name for name in POSES if np.isfinite(getattr(samples, name)).any()]
    has_effort = bool(np.isfinite(samples.effort).any())
    rows = []
    for k, joint in enumerate(samples.joints):
        unit = display_unit(robot.joint(joint).unit)
        width = unit.scale * samples.half_width[-1, k]
        cells = [
            (
                _number(unit.scale * getattr(samples, name)[-1, k], 2),
                f"{width:.2f}" if name == "corrected" and np.isfinite(width) else "",
            )
            for name in columns
        ]
        effort = _number(samples.effort[-1, k], 3), samples.effort_units[k]
        rows.append(
            {"joint": joint, "unit": unit.name, "cells": cells, "effort": has_effort and effort}
        )
    return filled("table", [(TITLES[name], COLOURS[name]) for name in columns], rows, is_fresh)


def filled(macro: str, *values: Any) -> str:
    """Fill in a macro of the template."""
    return str(getattr(_macros(), macro)(*values)).strip()


@cache
def _macros() -> Any:
    loader = jinja2.PackageLoader("truejoint.monitor", "assets")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True)
    return environment.get_template("samples.html.j2").module


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "-"
