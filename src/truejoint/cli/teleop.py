"""`truejoint teleop`: move an arm by keys."""

import math
import os
import select
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import truejoint
from truejoint.cli import options
from truejoint.cli.console import command_line, out
from truejoint.cli.driven_arm import RealArm, home
from truejoint.errors import CommandRefused
from truejoint.files import check_target
from truejoint.robots.catalogue import DEFAULT
from truejoint.units import display_unit, with_unit

if TYPE_CHECKING:
    from truejoint.motion.teleoperation import Teleoperation

_PERIOD: Final = 0.02  # [s] between two looks at the keys
_REDRAW: Final = 0.1
# Kitty's keyboard protocol: ask for events of all keys, and give back what was there.
_ASK: Final = "\x1b[>11u\x1b[?u"
_GIVE_BACK: Final = "\x1b[<u"


def teleop(
    real: RealArm,
    robot: str = DEFAULT,
    seed: int = 0,
    record: Path | None = None,
    go_to: list[str] | None = None,
    force: bool = False,
) -> None:
    """Move an arm, simulated or with --ros real, by keys: joints, tool and grasper.

    Keys move while they are held; 9, Esc or Ctrl-C pauses the arm and ends. --go-to needs no keys.
    """
    import numpy as np

    from truejoint.crtk.protocol import SILENCE
    from truejoint.motion.teleoperation import Teleoperation
    from truejoint.robots.blocks import check_range

    if record is not None:
        check_target(record, overwrite=force)
    target = options.get_robot(robot)
    goals = options.joint_values("--go-to", go_to, {j.name: j.unit for j in target.joints})
    goal = np.array([goals.get(name, math.nan) for name in target.joint_names])
    check_range(target, goal[None], "--go-to")
    if not goals and not sys.stdin.isatty():
        raise CommandRefused("teleop reads keys from a terminal; run it in one, or give --go-to")

    def backend() -> "truejoint.crtk.Backend":
        return truejoint.crtk.PacedBackend(options.make_twin(robot, seed=seed))

    with ExitStack() as stack:
        device = stack.enter_context(real.or_twin(robot, backend))
        home(device, None)
        if record is not None:
            about: Any = {"session": "teleoperation", "command": command_line()}
            recorder = truejoint.recordings.Recorder(device, path=record, overwrite=force, **about)
            stack.enter_context(recorder)
        if goals:
            here = device.setpoint_js(math.inf).position
            device.move_jp(np.where(np.isnan(goal), here, goal)).wait()
            now = zip(target.joints, device.measured_js(SILENCE).position.tolist(), strict=True)
            out.print(", ".join(f"{joint.name} {with_unit(v, joint.unit)}" for joint, v in now))
            return
        jog = stack.enter_context(truejoint.motion.Jog(device))
        count = _from_terminal(Teleoperation(jog))
    out.print(f"{count} keys; the arm is {device.operating_state().state}")


def _from_terminal(operator: "Teleoperation") -> int:
    """Tell the keys that are pressed, showing what they do; gives how many were."""
    from rich.live import Live

    from truejoint.motion.teleoperation import key_events

    count, drawn, tells = 0, -1.0, False
    with _raw_terminal() as read, Live(console=out, auto_refresh=False, transient=True) as live:
        while not operator.is_over and operator.jog.motion.is_busy():
            for name, event in key_events(read(_PERIOD)):
                tells = tells or event == "release"
                count += 1
                operator.tell(name, event, time.monotonic())
            now = time.monotonic()
            operator.pass_time(now, tells_release=tells)
            if now - drawn > _REDRAW:
                live.update(_picture(operator), refresh=True)
                drawn = now
    if not operator.is_over:  # the arm has ended it, and says why
        operator.jog.motion.wait()
    return count


def _picture(operator: "Teleoperation") -> Any:
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    from truejoint.motion.teleoperation import FASTER, LEAVE, SLOWER

    arm, pairs = operator.jog.arm, list(operator.keys.values())
    state = arm.measured_js(1.0)
    table = Table(title=f"{arm.robot.title}, speed {100 * operator.share:.0f} %", box=None)
    for heading in ("keys", "moves", "now"):
        table.add_column(heading, justify="right" if heading == "now" else "left")
    for up, down in zip(pairs[::2], pairs[1::2], strict=True):
        what, now = up.action.removesuffix(" +"), ""
        if what in state.name:
            k = state.name.index(what)
            unit = display_unit(arm.robot.joints[k].unit)
            now = f"{state.position[k] * unit.scale:.2f} {unit.name}"
        style = "bold" if {up.action, down.action} & set(operator.held) else ""
        table.add_row(f"{up.name} {down.name}", what, now, style=style)
    help_line = f"{FASTER} {SLOWER} speed   space stop   {LEAVE} pause and leave"
    return Group(table, Text(help_line, style="dim"))


@contextmanager
def _raw_terminal() -> Iterator[Any]:
    """Terminal that gives keys as they are pressed; restored whatever happens.

    Yields a function that waits up to some seconds and returns what was typed meanwhile; a signal
    to end is as if the key to leave had been pressed, and raises KeyboardInterrupt at the end: an
    exception out of the handler would be lost where Python ignores it.
    """
    import termios  # no such thing on Windows
    import tty

    descriptor = sys.stdin.fileno()
    signals: list[int] = []
    before = termios.tcgetattr(descriptor)

    def read(timeout: float) -> str:
        if signals:
            return "\x04"
        if not select.select([descriptor], [], [], timeout)[0]:
            return ""
        typed = os.read(descriptor, 1024)
        # The other end is gone: as if the key to leave had been pressed.
        return typed.decode("utf-8", errors="replace") if typed else "\x04"

    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    old = {n: signal.signal(n, lambda number, _: signals.append(number)) for n in ends}
    try:
        tty.setcbreak(descriptor)
        sys.stdout.write(_ASK)
        sys.stdout.flush()
        yield read
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
        sys.stdout.write(_GIVE_BACK)
        sys.stdout.flush()
    if signals:
        raise KeyboardInterrupt
