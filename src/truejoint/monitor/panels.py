"""What the page shows of samples: poses, curves over time, and HTML; no browser in it."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Final

import jinja2
import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Panel
from truejoint.errors import shown_text
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
    "band": "rgba(47,129,216,0.22)", "stale": "#9aa0a6", "fault": "#d1242f",
}  # fmt: skip

EVERY: Final = "all calibrated"  # in place of a joint
_LATE: Final = 1.0  # [s]


def poses(samples: Samples, robot: Robot) -> dict[str, Array]:
    """Joint positions (n_joints,) [rad or m] of the latest row, by which they are of.

    A joint that is not corrected, or has no sensor, stands where it is reported. What is known of
    no joint is left out; without the reported position of every joint there is no pose at all.
    """
    reported, shown = samples.reported[-1], {}
    if samples.joints != robot.joint_names or not np.isfinite(reported).all():
        return {}
    for name in POSES:
        values = getattr(samples, name)[-1]
        if np.isfinite(values).any():
            shown[name] = np.where(np.isfinite(values), values, reported)
    return shown


def plots(samples: Samples, robot: Robot, joint: str = EVERY) -> dict[str, Panel]:
    """Give the plots of one joint, or of every calibrated one, of which something is known.

    They go by their titles. A correction has its interval as a band; so has the error that is left
    where the truth is known.
    """
    every = samples.calibrated if joint == EVERY else ()
    curves: dict[str, list[Curve]] = {}
    for name in every or (samples.joints[0] if joint == EVERY else joint,):
        curves |= _joint_curves(samples, robot, name, is_alone=not every)
    interval = Curve(samples.t, 1e3 * samples.interval, "longest interval", COLOURS["setpoint"])
    curves["between state messages [ms]"] = [interval]
    panels = {title: Panel(_finite(lines, samples.t), y=title) for title, lines in curves.items()}
    return {title: panel for title, panel in panels.items() if panel.curves}


def _joint_curves(
    samples: Samples, robot: Robot, joint: str, *, is_alone: bool
) -> dict[str, list[Curve]]:
    """Curves of a joint by title; with positions and effort where it `is_alone`."""
    k, unit = samples.joints.index(joint), display_unit(robot.joint(joint).unit)
    reported, truth = samples.reported[:, k], samples.truth[:, k]
    corrected, width = samples.corrected[:, k], samples.half_width[:, k]

    def curve(label: str, colour: str, values: Array) -> Curve:
        return Curve(samples.t, values, label, COLOURS[colour])

    def with_band(values: Array, *more: Curve) -> list[Curve]:
        return [*(curve("", "band", unit.scale * (values + s * width)) for s in (1, -1)), *more]

    shown = f"{joint} [{unit.name}]"
    positions = [
        curve(title, name, unit.scale * getattr(samples, name)[:, k])
        for name, title in TITLES.items()
    ]
    correction = with_band(
        corrected - reported,
        curve("corrected - reported", "corrected", unit.scale * (corrected - reported)),
        curve("true - reported", "truth", unit.scale * (truth - reported)),
    )
    error = curve("corrected - true", "corrected", unit.scale * (corrected - truth))
    curves = {f"correction of {shown}": correction}
    if np.isfinite(corrected - truth).any():
        curves[f"corrected - true, {shown}"] = with_band(np.zeros_like(truth), error)
    if not is_alone:
        return curves
    effort = curve("reported", "reported", samples.effort[:, k])
    return {shown: positions, **curves, f"effort of {joint} [{samples.effort_units[k]}]": [effort]}


def overview(samples: Samples, robot: Robot, joint: str) -> Panel:
    """Plot over a whole recording: what is left of a joint's error, else its correction.

    Of each of its stretches the largest is shown; without either, what was reported.
    """
    k, unit = samples.joints.index(joint), display_unit(robot.joint(joint).unit)
    corrected, reported = samples.corrected[:, k], samples.reported[:, k]
    curves = {
        "corrected - true": corrected - samples.truth[:, k],
        "corrected - reported": corrected - reported,
        "reported": reported,
    }
    title, values = next(each for each in curves.items() if np.isfinite(each[1]).any())
    rows = samples.largest(values)
    rows = rows[np.isfinite(values[rows])]
    curve = Curve(samples.t[rows], unit.scale * values[rows], title, COLOURS["setpoint"])
    return Panel([curve], y=f"whole recording: {title}, {joint} [{unit.name}]")


def _finite(curves: Sequence[Curve], t: Array) -> list[Curve]:
    """Leave out curves unknown of late, then rows where one is NaN: one empties viser's plots."""
    late = t > t[-1] - _LATE
    recent = [curve for curve in curves if np.isfinite(np.asarray(curve.y)[late]).any()]
    rows = np.ones(len(t), dtype=bool)
    for curve in recent:
        rows &= np.isfinite(curve.y)
    return [replace(c, x=t[rows], y=np.asarray(c.y)[rows]) for c in recent] if rows.any() else []


def status_html(condition: Condition, samples: Samples | None, silence: float = 0.0) -> str:
    """Say how the arm stands: state, why, clock, and what the corrector says.

    `silence` is how long nothing has been heard [s], where the arm's own clock does not say.
    """
    colour = COLOURS["truth" if not condition.reason else "reported"]
    if condition.state in ("FAULT", "no answer"):
        colour = COLOURS["fault"]
    if samples is None:
        return filled("status", colour, condition, None, "", "")
    t, age = float(samples.t[-1]), ""
    if not condition.is_fresh and (seconds := np.fmax(condition.t - t, silence)) > 0.0:
        age = f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
    words = Status(int(samples.status[-1]))
    return filled("status", colour, condition, t, age, words.words if words else "")


def table_html(samples: Samples, robot: Robot, *, is_fresh: bool) -> str:
    """Table of the latest row, a joint a line, of what was known of late; grey if not of now."""
    columns = {name: getattr(samples, name) for name in POSES}
    columns["error"] = samples.corrected - samples.truth
    columns = {name: values for name, values in columns.items() if np.isfinite(values).any()}
    has_effort = bool(np.isfinite(samples.effort).any())
    rows = []
    for k, joint in enumerate(samples.joints):
        unit = display_unit(robot.joint(joint).unit)
        width = unit.scale * samples.half_width[-1, k]
        cells = [
            (
                _number(unit.scale * values[-1, k], 2),
                f"{width:.2f}" if name == "corrected" and np.isfinite(width) else "",
            )
            for name, values in columns.items()
        ]
        effort = _number(samples.effort[-1, k], 3), samples.effort_units[k]
        rows.append((joint, unit.name, cells, effort if has_effort else None))
    header = [(TITLES.get(name, name), COLOURS.get(name, "inherit")) for name in columns]
    return filled("table", header, rows, is_fresh)


def filled(macro: str, *values: Any) -> str:
    """Fill in a macro of the template."""
    return str(getattr(_macros(), macro)(*values)).strip()


@cache
def _macros() -> Any:
    loader = jinja2.PackageLoader("truejoint.monitor", "assets")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, finalize=shown_text
    )
    return environment.get_template("samples.html.j2").module


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "-"
