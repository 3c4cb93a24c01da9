"""`truejoint teleop`: move an arm by keys."""

from __future__ import annotations

import csv
import os
import select
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import truejoint
from truejoint.cli.collect import home
from truejoint.cli.console import command_line, out, say
from truejoint.cli.driven_arm import RealArm
from truejoint.cli.options import make_twin
from truejoint.errors import CommandRefused, TruejointError
from truejoint.files import check_target, read_small, write_atomically
from truejoint.robots.catalogue import DEFAULT
from truejoint.units import display_unit

if TYPE_CHECKING:
    from truejoint.motion.teleoperation import Event, Gamepad, Teleoperation

_PERIOD: Final = 0.02  # [s] between two looks at the keys
_REDRAW: Final = 0.1
_MOST_BYTES: Final = 1 << 24
# Kitty's keyboard protocol: ask for events of all keys, and give back what was there.
_ASK: Final = "\x1b[>11u\x1b[?u"
_GIVE_BACK: Final = "\x1b[<u"
_HEADER: Final = ("t_s", "key", "event")
_EVENTS: Final = ("press", "repeat", "release")

Events = list[tuple[float, str, "Event"]]


def teleop(
    real: RealArm,
    robot: str = DEFAULT,
    seed: int = 0,
    record: Path | None = None,
    save_keys: Path | None = None,
    keys: Path | None = None,
    gamepad: bool = False,
    force: bool = False,
) -> None:
    """Move an arm, simulated or with --ros real, by keys: joints, tool and grasper.

    Keys move while they are held; 9, Esc or Ctrl-C pauses the arm and ends.
    """
    from truejoint.motion.teleoperation import Gamepad, Teleoperation

    for target in filter(None, (record, save_keys)):
        check_target(target, overwrite=force)
    replayed = None if keys is None else _read_keys(keys)
    if keys is None and not sys.stdin.isatty():
        raise CommandRefused("teleop reads keys from a terminal; run it in one, or give --keys")

    def backend() -> truejoint.crtk.Backend:
        return truejoint.crtk.PacedBackend(make_twin(robot, seed=seed))

    with ExitStack() as stack:
        device = stack.enter_context(real.or_twin(robot, backend, seed))
        home(device, None)
        if record is not None:
            about: Any = {"session": "teleoperation", "command": command_line()}
            recorder = truejoint.recordings.Recorder(device, path=record, overwrite=force, **about)
            stack.enter_context(recorder)
        jog = stack.enter_context(truejoint.motion.Jog(device))
        operator = Teleoperation(jog)
        pad = stack.enter_context(Gamepad(operator)) if gamepad else None
        events = _from_terminal(operator, pad) if replayed is None else _replay(operator, replayed)
    if save_keys is not None:
        write_atomically(save_keys, partial(_write_keys, events), overwrite=force)
    out.print(f"{len(events)} keys; the arm is {device.operating_state().state}")


def _replay(operator: Teleoperation, events: Events) -> Events:
    """Tell the keys of a file at their times."""
    start = time.monotonic()
    tells_release = any(event == "release" for _, _, event in events)
    for t, name, event in [*events, (events[-1][0] + 1.0 if events else 0.0, "9", "press")]:
        while (remaining_s := start + t - time.monotonic()) > 0.0:
            time.sleep(min(remaining_s, _PERIOD))
            operator.pass_time(time.monotonic() - start, tells_release=tells_release)
            if not operator.jog.motion.is_busy():
                operator.jog.motion.wait()  # says what ended it
        operator.tell(name, event, t)
        if operator.is_over:
            break
    return events


def _from_terminal(operator: Teleoperation, pad: Gamepad | None) -> Events:
    """Tell the keys that are pressed and what a gamepad tells, showing what they do."""
    from rich.live import Live

    from truejoint.motion.teleoperation import key_events

    events: Events = []
    start, drawn, tells = time.monotonic(), -1.0, False
    with _raw_terminal() as read, Live(console=out, auto_refresh=False, transient=True) as live:
        while not operator.is_over and operator.jog.motion.is_busy():
            for name, event in key_events(read(_PERIOD)):
                now = time.monotonic() - start
                tells = tells or event == "release"
                events.append((now, name, event))
                operator.tell(name, event, now)
            now = time.monotonic() - start
            operator.pass_time(now, tells_release=tells)
            if pad is not None:
                pad.update(now)
            if now - drawn > _REDRAW:
                live.update(_picture(operator), refresh=True)
                drawn = now
    if pad is not None and pad.is_gone:
        say("the gamepad is gone: the arm was stopped and paused")
    return events


def _picture(operator: Teleoperation) -> Any:
    """Key map, positions and what is held."""
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


def _write_keys(events: Events, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(_HEADER)
        for t, name, event in events:  # what cannot be seen by its number, such as U+0020
            is_seen = name.isprintable() and name != " "
            writer.writerow((f"{t:.4f}", name if is_seen else f"U+{ord(name):04X}", event))


def _read_keys(path: Path) -> Events:
    """Keys of a file that `_write_keys` wrote; raises TruejointError, naming the line."""
    text = read_small(path, TruejointError, _MOST_BYTES, "keys").decode("utf-8", "replace")
    rows = list(csv.reader(text.splitlines()))
    if not rows or tuple(rows[0]) != _HEADER:
        raise TruejointError(f"{path}: is no file of keys; its first line must be t_s,key,event")
    events: Events = []
    for number, row in enumerate(rows[1:], 2):
        last = events[-1][0] if events else 0.0
        with suppress(ValueError, IndexError, OverflowError):
            t, name, event = float(row[0]), row[1], row[2]
            if name.startswith("U+"):
                name = chr(int(name[2:], 16))
            if event in _EVENTS and len(name) == 1 and last <= t < 86400.0:
                events.append((t, name, event))  # type: ignore[arg-type]  # one of these
                continue
        raise TruejointError(
            f"{path}: line {number} is {','.join(row)[:60]!r}; want a time that does not fall "
            "[s], a key (a character, or U+0020) and press, repeat or release"
        )
    return events
