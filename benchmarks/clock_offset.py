"""How well the motion tells the offset of two clocks: truth put on a clock of its own, and joined.

    python -m benchmarks.clock_offset [--seeds 5]

Each recording of the public data sets, and sessions on the simulated RAVEN-II, is parted into what
the robot recorded and a truth whose clock is off by up to 500 s, which begins and ends elsewhere
and has all, a half or a third of the rows where there are many. What repeats itself is refused at
first, and then told the offset to 0.1 s. Prints a Markdown table; errors in ms. A lag of the joint
itself counts as error here.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from truejoint.crtk import simulated_arm
from truejoint.errors import RecordingError
from truejoint.motion import follow, random_motion
from truejoint.recordings import ClockOffset, Recorder, Recording, Stream, join_truth
from truejoint.recordings.datasets import DATASETS, read_dataset

FAST = 20.0
"""Rate [Hz] above which rows of the truth are left out."""
REACH = 500.0
"""Largest offset [s]."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    seeds = parser.parse_args().seeds
    print("| recordings | trials | repeat | error, median | largest | sd, median | within 2 sd |")
    print("|---|---|---|---|---|---|---|")
    for name, recordings in _sets(seeds):
        rows = [_trial(r, seed) for seed in range(seeds) for r in recordings]
        errors, sds = np.array([(1e3 * error, 1e3 * sd) for _, error, sd in rows]).T
        off = np.abs(errors)
        print(
            f"| {name} | {len(rows)} | {sum(hinted for hinted, _, _ in rows)} "
            f"| {np.median(errors):.1f} | {off.max():.1f} | {np.median(sds):.1f} "
            f"| {100 * np.mean(off < 2 * sds):.0f} % |",
            flush=True,
        )


def _sets(seeds: int) -> Iterator[tuple[str, list[Recording]]]:
    for name, dataset in DATASETS.items():
        if dataset.splits:
            yield name, read_dataset(name, dataset.split().files)
    yield "simulated RAVEN-II, 3 min", [_session(seed) for seed in range(seeds)]


def _session(seed: int) -> Recording:
    arm = simulated_arm("raven2", "left", seed=seed)
    arm.enable()
    arm.home()
    with Recorder(arm) as recorder:
        follow(arm, random_motion(arm.robot, duration=180.0, seed=seed))
    recording = recorder.recording()
    return recording.with_truth(recording.joints_of("truth"))


def _trial(recording: Recording, seed: int) -> tuple[bool, float, float]:
    """Whether a hint was needed, the error of the offset and its stated deviation [s]."""
    random = np.random.default_rng(seed)
    offset = random.uniform(-REACH, REACH)
    begin, end = random.uniform((0.0, 0.85), (0.15, 1.0)) * len(recording)
    rate = 1.0 / float(np.median(np.diff(recording.t)))
    rows = slice(int(begin), int(end), int(random.integers(1, 4)) if rate > FAST else 1)
    joints = recording.joints_of("truth")
    truth = {f"truth/{joint}": recording.column(f"truth/{joint}")[rows] for joint in joints}
    kept = [column for column in recording.table if not str(column).startswith("truth")]
    robot = Recording.from_columns(recording.table[kept], recording.provenance.robot)
    stream = Stream(recording.t[rows] - offset, truth)
    hinted, found = False, ClockOffset(0.0)
    try:
        _, found = join_truth(robot, stream)
    except RecordingError:
        hinted = True
        _, found = join_truth(robot, stream, near=offset + random.uniform(-0.1, 0.1))
    return hinted, found.seconds - offset, found.sd


if __name__ == "__main__":
    main()
