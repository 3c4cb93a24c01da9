"""Tests of `truejoint teleop`, over a real pseudo-terminal."""

import math
import os
import pty
import select
import signal
import subprocess
import sys
import termios
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from truejoint.cli import teleop
from truejoint.crtk import Motion
from truejoint.errors import MotionStopped
from truejoint.recordings import read_parquet

LIMIT = 120.0  # [s] in which a terminal shows what it is to show
PROGRAM = """
import sys
from truejoint.cli.app import main
for line in sys.argv[1:]:
    sys.argv = ["truejoint", "teleop", "--robot", "forceps", *line.split()]
    try:
        main()
    except SystemExit as stop:
        print("ended with", stop.code, flush=True)
    input()
"""


class Terminal:
    """The command in a pseudo-terminal of its own, once for each of these lines."""

    def __init__(self, *lines):
        self.ours, self.theirs = pty.openpty()
        self.before = termios.tcgetattr(self.theirs)
        self.process = subprocess.Popen(  # noqa: S603  # our own program
            [sys.executable, "-c", PROGRAM, *lines],
            stdin=self.theirs, stdout=self.theirs, stderr=self.theirs,
            start_new_session=True, env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
        )  # fmt: skip

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        os.close(self.ours)
        os.close(self.theirs)

    def until(self, text):
        """Wait until the terminal shows something new that holds `text`; gives all of that."""
        shown = ""
        while text not in shown:
            assert select.select([self.ours], [], [], LIMIT)[0], shown
            shown += os.read(self.ours, 65536).decode("utf-8", "replace")
        return shown

    def type(self, text):
        os.write(self.ours, text.encode())

    def ends_with(self, code):
        """Wait for the end of a line, after which the terminal must be as it was."""
        shown = self.until(f"ended with {code}\r\n")
        assert termios.tcgetattr(self.theirs) == self.before
        self.type("\n")
        return shown


def test_an_arm_that_ends_it_says_why(monkeypatch):
    motion = Motion("jog", math.inf, print)
    motion.ended(motion.stopped("PAUSED", 2.0))
    monkeypatch.setattr(teleop, "_raw_terminal", lambda: nullcontext(None))
    operator: Any = SimpleNamespace(is_over=False, jog=SimpleNamespace(motion=motion))
    with pytest.raises(MotionStopped, match=r"^jog stopped at t = 2.000 s: PAUSED$"):
        teleop._from_terminal(operator)


def test_keys_move_the_arm_and_however_it_ends_the_terminal_is_restored(tmp_path):
    recorded = tmp_path / "jaw.parquet"
    signals = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
    with Terminal(f"--record {recorded}", *[""] * len(signals)) as terminal:
        terminal.until("pause and leave")
        terminal.type("+")
        for _ in range(3):
            terminal.type("1")
            terminal.until("jaw")
        terminal.type("9")
        assert "the arm is PAUSED" in terminal.ends_with(0)
        moved = read_parquet(recorded).column("setpoint/jaw")
        assert moved[-1] > moved[0] + 1e-3
        for number in signals:
            terminal.until("pause and leave")
            os.kill(terminal.process.pid, number)
            terminal.ends_with(130)
        assert terminal.process.wait(LIMIT) == 0
