"""Tests of `truejoint teleop`, over a real pseudo-terminal."""

import os
import pty
import select
import signal
import subprocess
import sys
import termios

import pytest

from truejoint.recordings import read_parquet

LIMIT = 120.0  # [s] in which a terminal shows what it is to show


class Terminal:
    """The command in a pseudo-terminal of its own."""

    def __init__(self, *arguments):
        self.ours, self.theirs = pty.openpty()
        self.before = termios.tcgetattr(self.theirs)
        command = [sys.executable, "-m", "truejoint", "teleop", "--robot", "forceps", *arguments]
        self.process = subprocess.Popen(  # noqa: S603  # our own command
            command, stdin=self.theirs, stdout=self.theirs, stderr=self.theirs,
            start_new_session=True, env={**os.environ, "TERM": "xterm", "COLUMNS": "100"},
        )  # fmt: skip
        self.shown = ""

    def until(self, text):
        """Wait until the terminal shows something new that holds `text`."""
        self.shown = ""
        while text not in self.shown:
            assert select.select([self.ours], [], [], LIMIT)[0], self.shown
            self.shown += os.read(self.ours, 65536).decode("utf-8", "replace")

    def type(self, text):
        os.write(self.ours, text.encode())

    def end(self):
        """Exit code; the terminal must be as it was."""
        for _ in range(round(10 * LIMIT)):
            if self.process.poll() is not None:
                break
            if select.select([self.ours], [], [], 0.1)[0]:
                self.shown += os.read(self.ours, 65536).decode("utf-8", "replace")
        while select.select([self.ours], [], [], 0.0)[0]:
            self.shown += os.read(self.ours, 65536).decode("utf-8", "replace")
        assert termios.tcgetattr(self.theirs) == self.before
        return self.process.poll()


@pytest.fixture
def terminal():
    opened = []

    def start(*arguments):
        opened.append(Terminal(*map(str, arguments)))
        return opened[-1]

    yield start
    for one in opened:
        if one.process.poll() is None:
            one.process.kill()
            one.process.wait()
        os.close(one.ours)
        os.close(one.theirs)


def test_keys_move_the_arm(terminal, tmp_path):
    recorded = tmp_path / "jaw.parquet"
    by_hand = terminal("--record", recorded)
    by_hand.until("pause and leave")
    by_hand.type("+")
    for _ in range(3):
        by_hand.type("1")
        by_hand.until("jaw")
    by_hand.type("9")
    assert by_hand.end() == 0, by_hand.shown
    assert "the arm is PAUSED" in by_hand.shown
    moved = read_parquet(recorded).column("setpoint/jaw")
    assert moved[-1] > moved[0] + 1e-3


def test_however_it_ends_the_terminal_is_restored(terminal):
    signals = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
    stopped = [terminal() for _ in signals]  # which home at the same time
    for each, number in zip(stopped, signals, strict=True):
        each.until("pause and leave")
        os.kill(each.process.pid, number)
        assert each.end() == 130, each.shown
