"""Send frames to the monitor's socket, its own and damaged ones.

    python -m tests.fuzz.frames [--count 1000000] [--seed N]

Prints how many frames were sent, how many connections they ended, and what the page wrote that is
no line of its log; exit code 1 if it wrote a traceback, stopped to answer, or grew by 100 MB.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from .cases import FRAMES, Draw

SERVER = """
import os, time
from truejoint.monitor.process import ArmView
from truejoint.monitor.samples import Condition
from truejoint.robots import get_robot
view = ArmView(get_robot("raven2"), lambda name: None, host="127.0.0.1", port=0)
names = [view.pause._impl.uuid, view.resume._impl.uuid, view._joint._impl.uuid]
print(view.url, *names, flush=True)
started_by = os.getppid()
while os.getppid() == started_by:
    view.show(None, Condition("ENABLED"))
    view.draw()
    time.sleep(0.1)
"""
MOST_GROWTH = 100e6  # bytes
DAMAGED = 0.002  # share of the frames: each that is refused costs a connection


def memory(process: int) -> float:
    """Bytes that a process holds."""
    return float(Path(f"/proc/{process}/statm").read_text().split()[1]) * 4096


def main() -> int:
    """Send frames; 1 when anything went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    server = subprocess.Popen(  # noqa: S603  # the text above, by this Python
        [sys.executable, "-c", SERVER], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    url, *names = server.stdout.readline().split()
    draw = Draw(options.seed, 0, Path(__file__).parent, Path())
    own = [msgspec.msgpack.decode(frame) for frame in FRAMES]
    values = (True, False, 0.0, -1.0, 1e300, 7, "elbow", "", "x" * 999, "\x1b[31m")
    sent = ended = 0
    spoken, before = [Subprotocol(f"viser-v{viser.__version__}")], 0.0
    while sent < options.count:
        # What comes is read by a thread of the client, and kept until the connection ends.
        address = url.replace("http", "ws")
        with connect(address, subprotocols=spoken, max_size=None, max_queue=None) as client:
            with contextlib.suppress(ConnectionClosed):
                while sent < options.count:
                    sent += 1
                    if draw.chance(DAMAGED):
                        client.send(draw.damaged(draw.one(FRAMES)))
                        continue
                    message = dict(draw.one(own))
                    if "uuid" in message:
                        message |= {"uuid": draw.one(names), "updates": {"value": draw.one(values)}}
                    else:
                        message["position"] = draw.rng.normal(size=3).tolist()
                    client.send(msgspec.msgpack.encode(message))
            ended += 1
        before = before or memory(server.pid)
    with connect(url.replace("http", "ws"), subprotocols=spoken) as client:
        answers = bool(client.recv(timeout=60))
    time.sleep(1.0)
    growth = memory(server.pid) - before
    server.kill()
    said = server.communicate()[1]
    is_bad = "Traceback" in said or not answers or growth > MOST_GROWTH
    sys.stdout.write(
        f"{sent} frames, {ended} connections, {len(said.splitlines())} lines of log, memory grew "
        f"by {growth / 1e6:.0f} MB, seed {options.seed}: {'wrong' if is_bad else 'good'}\n"
        f"{said[-1500:] if is_bad else ''}"
    )
    return int(is_bad)


if __name__ == "__main__":
    sys.exit(main())
