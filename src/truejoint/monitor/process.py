"""The page of an arm in a process of its own, so that drawing takes no turn of the arm's loop.

Both sides speak lines of JSON over the pipes of the process: numbers and text, nothing that could
run. It ends when its input does, so also when who started it is killed.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final

import numpy as np

import truejoint
from truejoint.errors import TruejointError
from truejoint.monitor.page import FRAME_RATE, WINDOW, Page
from truejoint.monitor.samples import Condition, Samples
from truejoint.robots import Robot

COMMANDS: Final = ("pause", "resume")  # what the buttons ask for

_NAMES: Final = ("joints", "effort_units")  # of samples: the rest are arrays
_PATIENCE: Final = 2.0  # [s] for it to end by itself
SILENCE: Final = 1.0  # [s] without a line from who drives the arm: the page says so
_LAST_WORDS: Final = 0.3  # [s] in which browsers hear that it ends
_RED: Final = (201, 42, 42)  # on which white letters stand out by 5 to 1


class PageProcess:
    """Starts the process, and tells it what to show.

    `on_command` is called with one of `COMMANDS`, in a thread of its own, when a button is pressed.
    `place` goes to `ArmView`. Raises as `Page`.
    """

    def __init__(self, robot: Robot, on_command: Callable[[str], None], **place: Any) -> None:
        package = str(Path(truejoint.__file__).parents[1])
        paths = [package, *filter(None, [os.environ.get("PYTHONPATH")])]
        self._telling = threading.Lock()
        self._process = subprocess.Popen(  # noqa: S603  # this module, by this Python
            # -P: no file in the folder that a person works in is taken for a module
            [sys.executable, "-P", "-m", __name__],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1,
            process_group=0,  # Ctrl-C is for who starts it, also while it begins
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        )  # fmt: skip
        self.pid: Final = self._process.pid
        self._input: Any = self._process.stdin
        output: Any = self._process.stdout
        self._output = output
        with suppress(BrokenPipeError):
            self._tell({"robot": robot.to_dict(), "place": place})
        said: dict[str, str] = json.loads(output.readline() or "{}")
        if "url" not in said:
            self.close()
            raise TruejointError(said.get("error", "the process of the page ended at once"))
        self.url: Final = said["url"]
        threading.Thread(
            target=self._listen, args=(on_command,), name="monitor's buttons", daemon=True
        ).start()

    def show(self, row: Samples | None, condition: Condition) -> None:
        """Show one more row, if there is one; raises BrokenPipeError if the process has ended."""
        self._tell({"row": None if row is None else _plain(row), "condition": vars(condition)})

    def stopped(self, error: Exception) -> None:
        """Say that nothing new will be shown, and why, if somebody still listens."""
        with suppress(OSError):
            self.show(None, Condition("the page has stopped", str(error), is_fresh=False))

    def say(self, error: Exception) -> None:
        """Tell all who look that something they asked for was refused, and why."""
        with suppress(BrokenPipeError):
            self._tell({"refused": str(error)})

    def close(self) -> None:
        """End the process."""
        if not self._telling.acquire(timeout=_PATIENCE):
            self._process.kill()  # it takes nothing any more, and holds up who tells it
            self._telling.acquire()
        with suppress(OSError):
            self._input.close()
        self._telling.release()
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        with suppress(OSError):
            self._output.close()

    def _tell(self, message: Mapping[str, Any]) -> None:
        with self._telling:
            if self._input.closed:
                raise BrokenPipeError(f"process {self.pid} of the page has ended")
            self._input.write(json.dumps(message) + "\n")

    def _listen(self, on_command: Callable[[str], None]) -> None:
        with suppress(OSError, ValueError):  # closed meanwhile
            for line in self._output:
                command = json.loads(line).get("command")
                if command in COMMANDS:  # each by itself: a pause waits for nothing
                    threading.Thread(target=on_command, args=(command,), daemon=True).start()


class ArmView(Page):
    """The page of an arm, in the process that draws it; `on_command` as of `PageProcess`.

    Where other computers reach it, it has no button that moves the arm without `remote_control`.
    """

    def __init__(
        self,
        robot: Robot,
        on_command: Callable[[str], None],
        *,
        host: str,
        port: int,
        remote_control: bool = False,
    ) -> None:
        self._on_command, self._remote_control = on_command, remote_control
        self.samples: Samples | None = None  # all rows that the plots may show
        self._condition = Condition("no answer", "the arm has said nothing yet", is_fresh=False)
        self._heard = self._reported = time.monotonic()
        super().__init__(robot, robot.joint_names, self._add_buttons, host=host, port=port)

    def show(self, row: Samples | None, condition: Condition) -> None:
        """Take what is to be shown in the next picture."""
        self._condition, self._heard = condition, time.monotonic()
        if row is not None:
            self._reported = self._heard
            latest = slice(-round(WINDOW * FRAME_RATE), None)
            before = [] if self.samples is None else [self.samples]
            self.samples = Samples.joined([*before, row]).rows(latest)

    def draw(self) -> None:
        """Make a picture of what is to be shown by now."""
        now, condition = time.monotonic(), self._condition
        if now - self._heard > SILENCE:
            why = f"of the program that drives the arm; it said last: {condition.state}"
            condition = replace(condition, state="no answer", reason=why, is_fresh=False)
        paused = condition.state.startswith("PAUSED")
        if self.resume is not None and self.resume.visible != paused:
            self.resume.visible = paused
        self.render(self.samples, condition, silence=now - self._reported)

    def _add_buttons(self, gui: Any) -> None:
        self.pause = gui.add_button("Pause the arm", color=_RED)
        self.pause.on_click(lambda _: self._on_command("pause"))
        self.resume: Any = None
        if self._remote_control or not self.is_remote:
            self.resume = gui.add_button("Resume", visible=False)
            self.resume.on_click(lambda _: self._on_command("resume"))


def _plain(row: Samples) -> dict[str, Any]:
    return {name: v if isinstance(v, tuple) else v.tolist() for name, v in vars(row).items()}


def _samples(values: Mapping[str, Any]) -> Samples:
    """Make samples of their plain values: the inverse of `_plain`."""
    kinds: Any = {name: tuple if name in _NAMES else np.array for name in values}
    return Samples(**{name: kinds[name](value) for name, value in values.items()})


def main() -> None:
    """Show what the lines of the input say, until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who started this
    output = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints is no message
    said = threading.Lock()

    def tell(**message: str) -> None:
        with said, suppress(BrokenPipeError):
            output.write(json.dumps(message) + "\n")

    asked = json.loads(sys.stdin.readline())
    robot = Robot.from_dict(asked["robot"], "the arm")
    try:
        view = ArmView(robot, lambda name: tell(command=name), **asked["place"])
    except TruejointError as error:
        tell(error=str(error))
        return
    tell(url=view.url)
    messages: SimpleQueue[dict[str, Any] | None] = SimpleQueue()
    drawing = threading.Thread(target=_draw, args=(view, messages), daemon=True)
    drawing.start()
    for line in sys.stdin:
        message = json.loads(line)
        if "refused" in message:
            view.say(TruejointError(message["refused"]))
        else:
            messages.put(message)
    messages.put(None)
    drawing.join(_PATIENCE)
    view.stopped(TruejointError("the program that drives the arm has ended"))
    time.sleep(_LAST_WORDS)
    view.close()


def _draw(view: ArmView, messages: SimpleQueue[dict[str, Any] | None]) -> None:
    """Draw what comes, all that has come meanwhile in one picture, until None comes."""
    try:
        while True:
            with suppress(Empty):
                if (message := messages.get(timeout=SILENCE)) is None:
                    return
                row = message["row"]
                view.show(None if row is None else _samples(row), Condition(**message["condition"]))
            if messages.empty():
                view.draw()
    except Exception as error:
        view.stopped(error)
        raise


if __name__ == "__main__":
    main()
