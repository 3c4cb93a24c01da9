"""Make the picture of the monitor, of a recording of ``make demo`` and its model, re-zeroed.

Run ``python -m docs.pictures.monitor DEMO`` in the repository; it needs Chromium.
"""

from __future__ import annotations

import base64
import io
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from tests.chromium import Chromium

import truejoint
from truejoint.calibration import find_zero
from truejoint.monitor import RecordingPage

LATER = 8.0  # s until everything is drawn without graphics hardware


def draw(demo: Path, target: Path) -> None:
    """Open the page as it comes up, close what the browser says of itself, and look."""
    recording = truejoint.read_recording(demo / "random.parquet")
    model = truejoint.read_calibration(demo / "left_arm.safetensors")
    model = model.at(find_zero(model, recording[: recording.t[0] + 10.0]))
    with (
        RecordingPage(recording, model, port=0) as page,
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        Chromium(Path(folder), 1280, 800) as browser,
    ):
        browser.open(page.url)
        browser.until("document.querySelector('#clock') !== null")
        time.sleep(LATER)
        browser.evaluate("document.querySelector('.mantine-Notification-closeButton')?.click()")
        time.sleep(LATER)
        data = browser.call("Page.captureScreenshot", format="png")["data"]
    Image.open(io.BytesIO(base64.b64decode(data))).convert("P", palette=1, colors=255).save(
        target, optimize=True
    )


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(__file__).with_name("monitor.png"))
