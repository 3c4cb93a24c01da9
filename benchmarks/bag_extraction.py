"""How fast a bag becomes a recording, beside ROS's own rosbag, and how much memory it takes.

    python -m benchmarks.bag_extraction [--seconds 60] [--hours 0]

Writes a bag of RAVEN-II's state at 1 kHz, reads the same fields of it (stamp, jpos, jvel, tau,
jpos_d) with `truejoint.recordings.read_bag` and with Debian's rosbag in Python, by turns, each in a
process of its own on one core, and prints seconds, messages a second and the ratio of the medians.
With ``--hours 6`` it also calls ``truejoint extract`` on a session of that length at 100 Hz with
joint sensors, and prints the largest memory of the process. Needs Debian's python3-rosbag.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

import numpy as np
from rosbags.rosbag1 import Writer

from truejoint.crtk.messages import DEFINITIONS, RAVEN_STATE
from truejoint.recordings.read.bags.fields import full_name, typesys

OURS = """
import resource, sys, time
from truejoint.recordings import read_bag
read_bag
begin = time.perf_counter()
recording = read_bag(sys.argv[1], "raven2")
seconds = time.perf_counter() - begin
print(seconds, len(recording), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
THEIRS = """
import resource, sys, time
import rosbag
begin = time.perf_counter()
rows = []
for _, m, _ in rosbag.Bag(sys.argv[1]).read_messages(["/ravenstate"]):
    rows.append((m.hdr.stamp.to_sec(), *m.jpos, *m.jvel, *m.tau, *m.jpos_d))
seconds = time.perf_counter() - begin
print(seconds, len(rows), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
EXTRACT = """
import resource, sys, time
from truejoint.cli.app import main
bag, begin = sys.argv[1], time.perf_counter()
sys.argv = ["truejoint", "extract", bag, "--robot", "raven2", "-o", bag + ".parquet"]
try:
    main()
except SystemExit as stop:
    assert not stop.code
import pyarrow.parquet
seconds, memory = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(seconds, pyarrow.parquet.read_metadata(bag + ".parquet").num_rows, memory)
"""


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--hours", type=float, default=0.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "fast.bag"
        write(bag, 1000.0, given.seconds, truth=False)
        runs = [(_run(sys.executable, OURS, bag), _run("/usr/bin/python3", THEIRS, bag))
                for _ in range(given.rounds)]  # fmt: skip
        for name, found in zip(("truejoint", "rosbag"), zip(*runs, strict=True), strict=True):
            seconds = median(run[0] for run in found)
            rate, memory = found[0][1] / seconds, found[0][2]
            print(f"{name}: {seconds:.2f} s, {rate:.0f} messages/s, {memory:.0f} MiB")
        ratio = median(theirs[0] / ours[0] for ours, theirs in runs)
        print(f"ratio of seconds, median of {given.rounds} rounds: {ratio:.1f}")
        bag.unlink()
        if given.hours:
            write(bag, 100.0, 3600.0 * given.hours, truth=True)
            size = bag.stat().st_size / 2**30
            seconds, rows, memory = _run(sys.executable, EXTRACT, bag)
            told = f"{size:.2f} GiB, {rows} rows in {seconds:.0f} s, {memory:.0f} MiB"
            print(f"{given.hours:g} h at 100 Hz: {told}")


def write(path: Path, rate: float, seconds: float, *, truth: bool) -> None:
    """Write RAVEN's state, and joint sensors, in which some numbers change from row to row."""
    system = typesys()
    store = system.get_typestore(system.Stores.ROS1_NOETIC)
    kind = full_name(RAVEN_STATE)
    store.register(system.get_types_from_msg(DEFINITIONS[RAVEN_STATE], kind))
    state = bytearray(980)  # with an empty frame
    sensors = bytearray(20 + 3 * 4 + 24 + 4)
    sensors[20:24] = (3).to_bytes(4, "little")  # behind the names, of which there are none
    sensors[16:20] = bytes(4)
    count = round(seconds * rate)
    swing = np.sin(np.arange(count)[:, None] * 0.7 / rate + np.arange(24)).astype(np.float32)
    with Writer(path) as writer:
        topic = writer.add_connection("/ravenstate", kind, typestore=store)
        joints = "sensor_msgs/msg/JointState"
        extra = writer.add_connection("/ext_jpos", joints, typestore=store) if truth else None
        for k in range(count):
            stamp = 1_700_000_000 * 10**9 + round(k * 1e9 / rate)
            head = k.to_bytes(4, "little") + b"".join(
                part.to_bytes(4, "little") for part in divmod(stamp, 10**9)
            )
            state[:12] = sensors[:12] = head
            state[16] = 3  # pedal down
            state[400:496] = swing[k].tobytes()
            writer.write(topic, stamp, bytes(state))
            if extra is not None:
                sensors[24:48] = swing[k, :3].astype(np.float64).tobytes()
                writer.write(extra, stamp, bytes(sensors))


def _run(python: str, script: str, bag: Path) -> tuple[float, int, float]:
    """Seconds, messages, and the largest memory [MiB] of a process on one core."""
    line = ["taskset", "-c", "0", python, "-c", script, str(bag)]
    told = subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()[-3:]
    return float(told[0]), int(told[1]), int(told[2]) / 1024


if __name__ == "__main__":
    main()
