"""The arm that a command drives: a digital twin's, or with `--ros` a real one's."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

import truejoint
from truejoint.cli import options
from truejoint.cli.node import joined
from truejoint.errors import CommandRefused
from truejoint.units import shown

if TYPE_CHECKING:
    from truejoint.crtk import Arm, Backend
    from truejoint.robots import Robot


@dataclass(frozen=True)
class RealArm:
    """Whether a real arm is driven, and which, an option each."""

    ros: int | None = None
    namespace: str = ""
    profile: str = ""
    truth: str = ""
    yes_move_it: bool = False

    @contextmanager
    def or_twin(self, robot: str, backend: Callable[[], Backend], *unused: object) -> Iterator[Arm]:
        """Switch on the arm of a twin or, once somebody has agreed, the one on ROS's topics.

        Options of the twin that are `unused` there are refused with `--ros`.
        """
        if self.ros is None:
            with truejoint.crtk.Arm(backend()) as device:
                yield device
            return
        if any(unused):
            raise CommandRefused(
                "--seed, --twin and --real-time are a simulated arm's: leave them out"
            )
        target = options.get_robot(robot)
        self._agree(target)
        with joined("truejoint", self.ros) as transport:
            over_ros = truejoint.crtk.RosBackend(
                transport, target, self.profile, namespace=self.namespace, truth=self.truth
            )
            with truejoint.crtk.Arm(over_ros) as device:
                yield device

    def _agree(self, robot: Robot) -> None:
        """Ask whether the arm may move; raises CommandRefused unless its name is typed."""
        fastest = {
            joint.unit: shown(joint.max_speed, f"{joint.unit}/s")
            for joint in sorted(robot.joints, key=lambda joint: joint.max_speed)
        }
        name = f"{robot.name}:{robot.arm}" if robot.arm else robot.name
        if self.yes_move_it:
            return
        what = f"a real arm moves, {name}, at up to {' and '.join(fastest.values())}"
        if not sys.stdin.isatty():
            raise CommandRefused(f"{what}: agree in a terminal, or give --yes-move-it")
        if typer.prompt(f"{what}. Type its name to go on", default="", err=True) != name:
            raise CommandRefused("nothing was moved: another name was typed")
