"""What the page says and draws of samples: words, a table, curves, poses; no browser in it."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.arm import Arm
from truejoint.crtk.states import check_ready
from truejoint.errors import TruejointError
from truejoint.monitor.samples import Samples
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
}  # fmt: skip

_LATE: Final = 1.0  # [s]

PLOTS: Final = ("position", "correction", "effort", "messages")


@dataclass(frozen=True)
class Condition:
    """How an arm, or the recording of one, stands.

    Attributes
    ----------
    state : str
        In a word or two: ``"ENABLED"``, ``"no answer"``.
    reason : str
        Why it takes no commands, or reports nothing new; empty where all is well.
    is_fresh : bool
        Whether the latest sample is of now.
    t : float
        Now, on the robot's clock [s]; NaN if it does not say.

    Examples
    --------
    >>> Condition.of(arm).state
    'ENABLED'
    """

    state: str
    reason: str = ""
    is_fresh: bool = True
    t: float = math.nan

    @classmethod
    def of(cls, arm: Arm) -> Self:
        """Ask an arm; one that does not answer is in a condition as well, never an error."""
        try:
            now = arm.operating_state()
        except Exception as error:  # noqa: BLE001  # whatever a back end raises is told
            return cls("no answer", " ".join(str(error).split()) or type(error).__name__, False)
        if now.is_busy and not now.is_homed:
            return cls("homing", "positions mean nothing before it is homed", False, now.t)
        reasons = []
        try:
            check_ready(replace(now, is_busy=False), "motion")
        except TruejointError as error:
            reasons.append(_without_command(error).removeprefix(f"the arm is {now.state}; "))
        try:
            arm.measured_js()
        except Exception as error:  # noqa: BLE001
            reasons.append(_without_command(error))
            return cls(now.state, reasons[0], False, now.t)
        state = f"{now.state}, moving" if now.is_busy else now.state
        return cls(state, "".join(reasons[:1]), True, now.t)


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a plot: what it is called, its colour and values (n,) as a person reads them."""

    label: str
    colour: str
    values: Array


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves over time `t` (n,) [s]; between the first two there is a band if `has_band`."""

    title: str
    t: Array
    curves: Sequence[Curve]
    has_band: bool = False


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
    reported, positions = samples.reported[-1], {}
    for name in POSES:
        values = getattr(samples, name)[-1]
        if np.isfinite(values).any():
            positions[name] = np.where(np.isfinite(values), values, reported)
    return positions


def plots(samples: Samples, robot: Robot, joint: str) -> dict[str, Plot]:
    """Give the plots of one joint, of `PLOTS` those of which something is known, by name.

    Examples
    --------
    >>> sorted(plots(Samples.of_recording(test, model), test.robot, "jaw"))
    ['correction', 'effort', 'messages', 'position']
    """
    k, unit = samples.joints.index(joint), display_unit(robot.joint(joint).unit)
    reported, truth = samples.reported[:, k], samples.truth[:, k]
    correction, width = samples.corrected[:, k] - reported, samples.half_width[:, k]
    position = [
        Curve(TITLES[name], COLOURS[name], unit.scale * getattr(samples, name)[:, k])
        for name in TITLES
    ]
    band = [
        Curve("", COLOURS["band"], unit.scale * (correction + side * width)) for side in (1, -1)
    ]
    errors = [
        Curve("corrected - reported", COLOURS["corrected"], unit.scale * correction),
        Curve("true - reported", COLOURS["truth"], unit.scale * (truth - reported)),
    ]
    has_band = bool(np.isfinite(width).any())
    longest = Curve("longest interval", COLOURS["setpoint"], 1e3 * samples.interval)
    all_plots = {
        "position": Plot(f"{joint} [{unit.name}]", samples.t, position),
        "correction": Plot(
            f"error of {joint} [{unit.name}]", samples.t, [*band, *errors] if has_band else errors
        ),
        "effort": Plot(
            f"effort of {joint} [{samples.effort_units[k]}]",
            samples.t,
            [Curve("reported", COLOURS["reported"], samples.effort[:, k])],
        ),
        "messages": Plot("between state messages [ms]", samples.t, [longest]),
    }
    drawn = {
        name: _known(plot, has_band and name == "correction") for name, plot in all_plots.items()
    }
    return {name: plot for name, plot in drawn.items() if plot.curves}


def status_html(condition: Condition, samples: Samples | None) -> str:
    """Say how the arm stands: state, why, clock, and what the corrector says."""
    colour = COLOURS["truth" if not condition.reason else "reported"]
    if condition.state in ("FAULT", "no answer"):
        colour = "#d1242f"
    lines = [
        f'<b style="color:{colour}">{html.escape(condition.state)}</b>'
        + (f" {html.escape(condition.reason)}" if condition.reason else "")
    ]
    if samples is None:
        lines.append("no state message yet")
        return _block(lines)
    t = float(samples.t[-1])
    clock = f'<span id="clock" data-t="{t:.4f}">t = {t:.2f} s</span>'
    if not condition.is_fresh and condition.t - t > 0.0:
        clock += f", {_duration(condition.t - t)} ago"
    lines.append(clock)
    status = Status(int(samples.status[-1]))
    if status:
        lines.append(f"<b>not corrected:</b> {html.escape(status.words)}")
    return _block(lines)


def table_html(samples: Samples, robot: Robot, *, is_fresh: bool) -> str:
    """Table of the latest row, a joint a line, of what was known of late; grey if not of now.

    Examples
    --------
    >>> "0.2" in table_html(Samples.of_recording(test, model), test.robot, is_fresh=True)
    True
    """
    columns = [name for name in POSES if np.isfinite(getattr(samples, name)).any()]
    has_effort = bool(np.isfinite(samples.effort).any())
    heads = ["<th></th>"]
    heads += [f'<th style="color:{COLOURS[name]}">{TITLES[name]}</th>' for name in columns]
    heads += ['<th class="effort">effort</th>'] if has_effort else []
    rows = []
    for k, joint in enumerate(samples.joints):
        unit = display_unit(robot.joint(joint).unit)
        cells = [f"<td>{html.escape(joint)} <small>{unit.name}</small></td>"]
        for name in columns:
            value = _number(getattr(samples, name)[-1, k] * unit.scale, 2)
            width = samples.half_width[-1, k] * unit.scale
            with_width = name == "corrected" and np.isfinite(width)
            value += f" <small>&plusmn; {width:.2f}</small>" if with_width else ""
            cells.append(f"<td>{value}</td>")
        if has_effort:
            effort = _number(samples.effort[-1, k], 3)
            effort += f" <small>{html.escape(samples.effort_units[k])}</small>"
            cells.append(f'<td class="effort">{effort}</td>')
        rows.append("<tr>" + "".join(cells) + "</tr>")
    shade = "" if is_fresh else ' class="stale"'
    head, body = "".join(heads), "".join(rows)
    return (
        f'<div id="joints-box"><table id="joints"{shade}><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def legend_html(shown: Sequence[str]) -> str:
    """Name the colours of the poses that are drawn."""
    marks = (
        f'<span><i style="background:{COLOURS[name]}"></i>{TITLES[name]}</span>' for name in shown
    )
    return f'<div id="legend">{"".join(marks)}</div>'


STYLE: Final = (
    "<style>#joints{width:100%;border-collapse:collapse;font-size:.78rem;"
    "font-variant-numeric:tabular-nums}#joints th{font-weight:600;text-align:right}"
    "#joints-box{container-type:inline-size}"
    "@container(max-width:340px){#joints .effort{display:none}}"
    ".said,#joints-box,#legend{margin:.15rem .6rem}.said{font-size:.82rem;line-height:1.4}"
    # viser's sheet takes up two thirds of a phone's width
    "@media(max-width:600px){[style*='width: 20em']{width:100%!important}}"
    ".uplot .u-title{font-size:.8rem;"
    "font-weight:600;line-height:1.3}.uplot .u-legend{font-size:.72rem;line-height:1.1;"
    "margin-top:.15rem}.uplot .unnamed{display:none}"
    "#joints td{text-align:right;padding:.1rem 0 .1rem .3rem;white-space:nowrap;"
    "border-top:1px solid rgba(128,128,128,.25)}#joints small{opacity:.65}"
    "#joints td:first-child{text-align:left;padding-left:0}"
    "#joints.stale{opacity:.45;filter:grayscale(1)}"
    "#legend{display:flex;gap:1rem;font-size:.8rem}#legend i{display:inline-block;width:.7rem;"
    "height:.7rem;border-radius:.2rem;margin-right:.35rem}</style>"
)


def _block(lines: Sequence[str]) -> str:
    return f'<div id="status" class="said">{"<br>".join(lines)}</div>'


def _known(plot: Plot, has_band: bool) -> Plot:
    """Leave out curves of which nothing was known of late, then rows where one is missing.

    The plots can draw no gap: a single NaN empties them.
    """
    late = plot.t > plot.t[-1] - _LATE
    drawn = [c for c in plot.curves if np.isfinite(c.values[late]).any()]
    rows = np.ones(len(plot.t), dtype=bool)
    for curve in drawn:
        rows &= np.isfinite(curve.values)
    cut = [replace(curve, values=curve.values[rows]) for curve in drawn]
    has_both = has_band and len(drawn) > 2 and not drawn[1].label
    return Plot(plot.title, plot.t[rows], cut if rows.any() else [], has_both)


def _without_command(error: Exception) -> str:
    """Give what an arm says, without the name of the command that it refused."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text.partition(" refused: ")[2] or text


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "-"


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60.0 else f"{seconds / 60.0:.0f} min"
