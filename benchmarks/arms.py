"""Arms, homed and recorded."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from truejoint.crtk import Arm, StateBlock, TruthBlock
from truejoint.motion import Trajectory, follow
from truejoint.recordings import Recorder, Recording

Block = TypeVar("Block", bound=StateBlock)


def homed(arm: Arm) -> Arm:
    """Enable and home an arm."""
    arm.enable()
    arm.home()
    return arm


def recorded(arm: Arm, *paths: Trajectory, **how: Any) -> Recording:
    """Record an arm that follows motions, `how` as `Recorder` takes it."""
    with Recorder(arm, **how) as recorder:
        for path in paths:
            follow(arm, path)
    return recorder.recording()


@contextmanager
def blocks_of(arm: Arm, kind: type[Block]) -> Iterator[list[Block]]:
    """Blocks of a kind that an arm gives to its subscribers meanwhile."""
    blocks: list[Block] = []

    def keep(block: StateBlock | TruthBlock) -> None:
        if isinstance(block, kind):
            blocks.append(block)

    arm.subscribe(keep)
    yield blocks
    arm.unsubscribe(keep)
