"""What the page says of samples, as HTML: how the arm stands, a table of joints, the colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import jinja2
import numpy as np

from truejoint.monitor.condition import Condition
from truejoint.monitor.panels import COLOURS, POSES, TITLES
from truejoint.monitor.samples import Samples
from truejoint.robots import Robot
from truejoint.runtime.status import Status
from truejoint.units import display_unit


def status_html(condition: Condition, samples: Samples | None) -> str:
    """Say how the arm stands: state, why, clock, and what the corrector says."""
    colour = COLOURS["truth" if not condition.reason else "reported"]
    if condition.state in ("FAULT", "no answer"):
        colour = COLOURS["fault"]
    if samples is None:
        return _filled("status", colour, condition, None, "", "")
    t = float(samples.t[-1])
    age = _duration(condition.t - t) if not condition.is_fresh and condition.t > t else ""
    words = Status(int(samples.status[-1]))
    return _filled("status", colour, condition, t, age, words.words if words else "")


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
    return _filled("table", [(TITLES[name], COLOURS[name]) for name in columns], rows, is_fresh)


def legend_html(shown: Sequence[str]) -> str:
    """Name the colours of the poses that are drawn."""
    return _filled("legend", [(TITLES[name], COLOURS[name]) for name in shown])


def style_html() -> str:
    """Give the style sheet of all these."""
    return _filled("style")


def _filled(macro: str, *values: Any) -> str:
    return str(getattr(_macros(), macro)(*values)).strip()


@cache
def _macros() -> Any:
    loader = jinja2.PackageLoader("truejoint.monitor", "assets")
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True)
    return environment.get_template("samples.html.j2").module


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "-"


def _duration(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 60.0 else f"{seconds / 60.0:.0f} min"
