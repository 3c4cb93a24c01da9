"""How well the motion tells the offset of two clocks: truth put on a clock of its own, and joined.

    python -m benchmarks.clock_offset [--seeds 5] [--sets zig-zag]

Each recording of the public data sets, and sessions on the simulated RAVEN-II, is parted into what
the robot recorded and a truth whose clock is off by up to 500 s, which begins and ends elsewhere
and has all, a half or a third of the rows where there are many. What repeats itself is refused at
first, and then told the offset to 0.1 s. One session is a single zig-zag with all readings of the
joint sensors, at 100 Hz, beside a state at 30 Hz. Prints a Markdown table; errors in ms. A lag of
the joint itself counts as error here.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Final

import numpy as np

from truejoint.crtk import StateBlock, TruthBlock, simulated_arm
from truejoint.errors import RecordingError
from truejoint.motion import follow, random_motion, zigzag
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
    parser.add_argument("--sets", default="", help="only sets with this in their name")
    given = parser.parse_args()
    seeds = given.seeds
    print("| recordings | trials | repeat | error, median | largest | sd, median | within 2 sd |")
    print("|---|---|---|---|---|---|---|")
    for name, sessions in _sets(seeds):
        if given.sets not in name:
            continue
        rows = [_trial(*session, seed) for seed in range(seeds) for session in sessions()]
        errors, sds = np.array([(1e3 * error, 1e3 * sd) for _, error, sd in rows]).T
        off = np.abs(errors)
        print(
            f"| {name} | {len(rows)} | {sum(hinted for hinted, _, _ in rows)} "
            f"| {np.median(errors):.1f} | {off.max():.1f} | {np.median(sds):.1f} "
            f"| {100 * np.mean(off < 2 * sds):.0f} % |",
            flush=True,
        )


def _sets(seeds: int) -> Iterator[tuple[str, Callable[[], list[Session]]]]:
    for name, dataset in DATASETS.items():
        if dataset.splits:
            yield name, partial(_recorded, name)
    random, zig_zag = (
        cache(lambda kind=kind: [_session(kind, seed) for seed in range(seeds)]) for kind in MOTIONS
    )
    yield "simulated RAVEN-II, 3 min", random
    yield "simulated RAVEN-II, one zig-zag", zig_zag


MOTIONS: Final = {
    "random": lambda robot, seed: random_motion(robot, duration=180.0, seed=seed),
    "zig-zag": lambda robot, _: zigzag(robot, sparsity=1 / 2),
}
Session = tuple[Recording, Stream]
"""What the robot recorded, and the truth on the same clock."""


@cache
def _recorded(name: str) -> list[Session]:
    recordings = read_dataset(name, DATASETS[name].split().files)
    return [_parted(recording) for recording in recordings]


def _parted(recording: Recording) -> Session:
    joints = recording.joints_of("truth")
    truth = {f"truth/{joint}": recording.column(f"truth/{joint}") for joint in joints}
    kept = [column for column in recording.table if not str(column).startswith("truth")]
    robot = Recording.from_columns(recording.table[kept], recording.provenance.robot)
    return robot, Stream(recording.t, truth)


def _session(kind: str, seed: int) -> Session:
    arm = simulated_arm("raven2", "left", seed=seed)
    arm.enable()
    arm.home()
    blocks: list[TruthBlock] = []

    def take(block: StateBlock | TruthBlock) -> None:
        if isinstance(block, TruthBlock):
            blocks.append(block)

    arm.subscribe(take)
    with Recorder(arm) as recorder:
        follow(arm, MOTIONS[kind](arm.robot, seed))
    recording = recorder.recording()
    if kind == "random":
        return _parted(recording.with_truth(recording.joints_of("truth")))
    truth = TruthBlock.joined(blocks)
    columns = {f"truth/{joint}": truth.position[:, k] for k, joint in enumerate(truth.name)}
    since_begin = truth.t - recording.provenance.start  # as the stamps of the recording are
    return _parted(recording)[0], Stream(since_begin, columns)


def _trial(robot: Recording, truth: Stream, seed: int) -> tuple[bool, float, float]:
    """Whether a hint was needed, the error of the offset and its stated deviation [s]."""
    random = np.random.default_rng(seed)
    offset = random.uniform(-REACH, REACH)
    begin, end = random.uniform((0.0, 0.85), (0.15, 1.0)) * len(truth.t)
    rate = 1.0 / float(np.median(np.diff(truth.t)))
    step = int(random.integers(1, 4)) if rate > FAST and len(truth.t) == len(robot) else 1
    rows = slice(int(begin), int(end), step)
    kept = {name: values[rows] for name, values in truth.columns.items()}
    stream = Stream(truth.t[rows] - offset, kept)
    hinted, found = False, ClockOffset(0.0)
    try:
        _, found = join_truth(robot, stream)
    except RecordingError:
        hinted = True
        _, found = join_truth(robot, stream, near=offset + random.uniform(-0.1, 0.1))
    return hinted, found.seconds - offset, found.sd


if __name__ == "__main__":
    main()
