"""Send frames to the sockets of the monitor's pages: their own, odd values and damaged ones.

    python -m tests.fuzz.frames [--count 1000000] [--seed N]

Prints how many frames were sent, how many connections they ended, and what the pages wrote that is
no line of their log. The arm must get the presses that whole frames asked for, and no other. Exit
code 1 if it did not, or if a page wrote a traceback or a line a second, stopped to answer or draw,
or grew by 100 MB.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from functools import partial
from pathlib import Path

import msgspec
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from truejoint.monitor.access import check_message

from .cases import FRAMES, Draw

SERVER = """
import json, os, sys, threading, time
from collections import Counter
from tests.synthetic import build_recording
from truejoint.monitor import RecordingPage
from truejoint.monitor.process import ArmView
from truejoint.monitor.samples import Condition, Samples
pressed = []
recording = build_recording(300)
row = Samples.of_recording(recording)
view = ArmView(recording.robot, pressed.append, host="127.0.0.1", port=0)
page = RecordingPage(recording, port=0)
widgets = [one._server.gui._gui_input_handle_from_uuid for one in (view, page._page)]
urls = [one.url.replace("http", "ws") for one in (view, page)]
buttons = [view.pause._impl.uuid, view.resume._impl.uuid]
print(json.dumps([*urls, *buttons, [list(one) for one in widgets]]), flush=True)
def answer():
    for _ in sys.stdin:
        alive = page._thread.is_alive() and drawing.is_alive()
        print(json.dumps([Counter(pressed), alive]), flush=True)
    os._exit(0)
def draw():
    while True:
        view.show(row, Condition("ENABLED"))
        view.draw()
        time.sleep(0.1)
drawing = threading.Thread(target=draw)
drawing.start()
answer()
"""
MOST_GROWTH = 100e6  # bytes
DAMAGED = 0.002  # share of the frames: each that is refused costs a connection
VALUES = (True, False, 0.0, -1.0, 1e300, 7, "elbow", "", "x" * 999, "\x1b[31m", "nan", "1e999")
speaking = partial(
    connect, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], max_size=None
)


def memory(process: int) -> float:
    """Bytes that a process holds."""
    return float(Path(f"/proc/{process}/statm").read_text().split()[1]) * 4096


def main() -> int:
    """Send frames; 1 when anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryFile("w+") as log:  # a pipe that nobody empties would stop the pages
        server = subprocess.Popen(  # noqa: S603  # the text above, by this Python
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True,
        )  # fmt: skip
        *urls, pause, resume, widgets = json.loads(server.stdout.readline())
        draw = Draw(options.seed, 0, Path(__file__).parent, Path())
        own = [msgspec.msgpack.decode(frame) for frame in FRAMES]
        sent = ended = before = 0
        asked: Counter[str] = Counter()
        began = time.monotonic()
        while sent < options.count:
            which = draw.one((0, 1))
            buttons = {pause: "pause", resume: "resume"} if which == 0 else {}
            is_open = True
            # What comes is read by a thread of the client, and kept until the connection ends.
            with suppress(ConnectionClosed), speaking(urls[which], max_queue=None) as client:
                client.send(FRAMES[1])  # who looks from nowhere presses nothing
                while is_open and sent < options.count:
                    sent += 1
                    message = dict(draw.one(own))
                    if "uuid" in message:
                        message |= {
                            "uuid": draw.one(widgets[which]), "updates": {"value": draw.one(VALUES)}
                        }  # fmt: skip
                    else:
                        message["position"] = draw.rng.normal(size=3).tolist()
                    frame = msgspec.msgpack.encode(message)
                    if draw.chance(DAMAGED):
                        frame = draw.damaged(frame)
                    with suppress(ValueError):  # the page ends the connection
                        is_open = False
                        check_message(frame)
                        is_open = True
                        message = msgspec.msgpack.decode(frame)
                        asked[buttons.get(message.get("uuid"), "")] += 1
                    if not is_open or sent == options.count:  # what is under way is lost with it
                        client.ping().wait(60)
                        time.sleep(0.1)
                    client.send(frame)
                for _ in client if not is_open else ():  # until it is closed
                    pass
                time.sleep(0.1)
            ended += 1
            before = before or memory(server.pid)
        answers = []
        for url in urls:
            with speaking(url) as client:
                answers.append(bool(client.recv(timeout=60)))
        time.sleep(1.0)
        growth = memory(server.pid) - before
        pressed, draws = json.loads(server.communicate("\n", timeout=60)[0])
        log.seek(0)
        said = log.read()
    asked.pop("", None)
    is_bad = (
        "Traceback" in said or not all(answers) or growth > MOST_GROWTH or not draws
        or pressed != asked or len(said.splitlines()) > 20 + time.monotonic() - began
    )  # fmt: skip
    sys.stdout.write(
        f"{sent} frames, {ended} connections, {len(said.splitlines())} lines of log, memory grew "
        f"by {growth / 1e6:.0f} MB, asked {dict(asked)}, pressed {pressed}, drawing {draws}, "
        f"seed {options.seed}: {'wrong' if is_bad else 'good'}\n{said[-1500:] if is_bad else ''}"
    )
    return int(is_bad)


if __name__ == "__main__":
    sys.exit(main())
