"""Take the manual's pictures of screens: the terminal, the report and the monitor.

After ``make demo``, run ``python docs/pictures/screens.py [NAME ...]`` in the checkout. It needs
the extras ``plots`` and ``monitor``, Chromium, and some minutes.
"""

from __future__ import annotations

import base64
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from rich.console import CONSOLE_SVG_FORMAT, Console
from rich.terminal_theme import DEFAULT_TERMINAL_THEME
from rich.text import Text

HERE: Final = Path(__file__).parent
sys.path += [str(HERE), str(HERE.parents[1])]

import manual  # noqa: E402
from tests.chromium import Chromium  # noqa: E402

import truejoint  # noqa: E402
from truejoint.motion import follow, random_motion  # noqa: E402
from truejoint.recordings import Recorder  # noqa: E402

WIDTH: Final = 84  # columns of the terminal


def commands(target: Path) -> None:
    """Draw the terminal after `truejoint`, without a font that is loaded from elsewhere."""
    env = os.environ | {"COLUMNS": str(WIDTH), "TERMINAL_WIDTH": str(WIDTH), "FORCE_COLOR": "1"}
    code = "from truejoint.cli.app import main; main()"
    run = [sys.executable, "-c", code]
    told = subprocess.run(run, env=env, capture_output=True, text=True, check=False)  # noqa: S603
    console = Console(record=True, width=WIDTH, file=StringIO())
    text = re.sub(r"Usage: \S+", "Usage: truejoint", told.stdout.replace(";40m", "m"))
    console.print(Text.from_ansi("$ truejoint\n" + text.strip("\n")))
    svg = re.sub(r"@font-face \{\{.*?\}\}\s*", "", CONSOLE_SVG_FORMAT, flags=re.DOTALL)
    drawn = console.export_svg(
        title="truejoint", theme=DEFAULT_TERMINAL_THEME, code_format=svg, unique_id="truejoint"
    )
    target.write_text("\n".join(line.rstrip() for line in drawn.splitlines()) + "\n", "utf-8")


def keep(browser: Chromium, target: Path) -> None:
    """Write what the browser shows."""
    shot = browser.call("Page.captureScreenshot", format="png")
    target.write_bytes(base64.b64decode(shot["data"]))


def report(target: Path) -> None:
    """Take the head of a report on the simulated RAVEN-II."""
    model = truejoint.calibrate(manual.training(), "linear")
    test = manual.recorded(random_motion(manual.twin().robot, 600.0, seed=9))
    evaluation = truejoint.evaluate(model, test, tolerance={"shoulder": np.radians(0.3)})
    with TemporaryDirectory() as folder:
        page = Path(folder) / "report.html"
        truejoint.evaluation.write_report(evaluation, page)
        with Chromium(Path(folder), 1280, 1000, ("--hide-scrollbars",)) as browser:
            browser.open(page.as_uri())
            browser.until("document.querySelectorAll('.js-plotly-plot').length > 0")
            time.sleep(2.0)
            keep(browser, target)


def watched(recording: truejoint.Recording, model: truejoint.Calibration, target: Path) -> None:
    """Take the monitor's page on a recording."""
    page = truejoint.monitor.RecordingPage(recording, model, port=0)
    with TemporaryDirectory() as folder, page, Chromium(Path(folder), 1280, 800) as browser:
        browser.open(page.url)
        browser.until("document.querySelectorAll('#joints tbody tr').length > 0")
        browser.until("Object.keys(window.__viserTestpoints?.uplots ?? {}).length >= 2")
        browser.evaluate("document.querySelector('.mantine-Notification-closeButton')?.click()")
        time.sleep(10.0)  # without graphics hardware the drawing takes some seconds
        keep(browser, target)


def monitor(target: Path) -> None:
    """Watch a recording of ``make demo`` with its model, re-zeroed."""
    demo = HERE.parents[1] / "demo"
    recording = truejoint.read_recording(demo / "random.parquet")
    model = truejoint.read_calibration(demo / "left_arm.safetensors")
    zero = truejoint.calibration.find_zero(model, recording[: recording.t[0] + 10.0])
    watched(recording, model.at(zero), target)


def wrist(target: Path) -> None:
    """Watch a random motion of a wristed instrument."""
    twin = truejoint.simulation.make_twin("wrist", "420172", parameters="endowrist", seed=0)
    arm = truejoint.crtk.Arm(truejoint.crtk.SimulatedBackend(twin))
    arm.enable()
    arm.home()
    made = []
    for seed, seconds in ((0, 120.0), (1, 20.0)):
        with Recorder(arm, state_rate=100.0) as recorder:
            follow(arm, random_motion(arm.robot, seconds, seed=seed))
        made.append(recorder.recording())
    watched(made[1], truejoint.calibrate(made[0], "coupled_play"), target)


SCREENS: Final[dict[str, Callable[[Path], None]]] = {
    "commands.svg": commands,
    "report.png": report,
    "monitor.png": monitor,
    "wrist.png": wrist,
}


if __name__ == "__main__":
    for name in sys.argv[1:] or SCREENS:
        SCREENS[name](HERE / name)
        print(HERE / name)  # noqa: T201
