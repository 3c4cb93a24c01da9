"""The `truejoint` command, from its start to its end, which is one line whatever happens.

Exit codes: 0 good, 1 a check failed, 2 the call was wrong, 70 truejoint is, 130 Ctrl-C.
"""

from __future__ import annotations

# Little is imported here: until `main` runs, Ctrl-C ends Python in Python's own words.
import atexit
import os
import signal
import sys
from contextlib import suppress

TYPE_CHECKING = False
if TYPE_CHECKING:  # typing takes milliseconds
    from typing import Any, Final

FAILED: Final = 2
FAULTY: Final = 70  # as EX_SOFTWARE of sysexits.h
INTERRUPTED: Final = 130
DEBUG: Final = "--debug"  # anywhere in the line


def main() -> None:
    """Run the command line; any error is one line, and the exit code says whose it is."""
    message, stopped = "", _Stop()
    debug = DEBUG in sys.argv
    sys.argv = [word for word in sys.argv if word != DEBUG]
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError):  # what stands in for a terminal's
            # A terminal that cannot show a character gets its number, as in forced ASCII.
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        from truejoint.cli.commands import built  # once Ctrl-C is looked after

        stopped.interrupts()
        code = int(built()(sys.argv[1:], prog_name="truejoint", standalone_mode=False) or 0)
        sys.stdout.flush()  # a full disk shall be told here, not by the interpreter
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001  # the last resort
        code, message = _outcome(error)
        if debug and (message or code == INTERRUPTED):
            import traceback

            traceback.print_exc()
    finally:
        stopped.ignores()  # all is written by now, but for this line
    if stopped.asked or code == INTERRUPTED:
        code, message = INTERRUPTED, "stopped"
    if message:
        from truejoint.cli.console import err, one_line

        with suppress(OSError):  # nobody reads it, or it goes to a full disk
            err.print(f"truejoint: {one_line(message)}", style="red", soft_wrap=True)
    stopped.restore()
    sys.exit(code)


class _Stop:
    """What Ctrl-C does: at first, while nothing is made yet, it ends the process on the spot.

    Later it interrupts, and that is remembered: not everything lets an interrupt through.
    """

    def __init__(self) -> None:
        self.asked = False
        self._before, self._hook = signal.getsignal(signal.SIGINT), sys.unraisablehook
        self._set(lambda *_: os._exit(INTERRUPTED))

    def interrupts(self) -> None:
        """From now on, Ctrl-C raises KeyboardInterrupt, and is silent where nothing can raise."""
        self._set(self._interrupt)
        sys.unraisablehook = self._unraisable

    def ignores(self) -> None:
        """From now on, Ctrl-C does nothing."""
        self._set(signal.SIG_IGN)

    def restore(self) -> None:
        """Do as before, but nothing again once the interpreter clears up."""
        atexit.register(self.ignores)
        self._set(self._before)
        sys.unraisablehook = self._hook

    def _set(self, handler: Any) -> None:
        # Not where it is ignored, as in the background, or where another program runs this one.
        if self._before is signal.default_int_handler:
            with suppress(ValueError):  # not the main thread
                signal.signal(signal.SIGINT, handler)

    def _unraisable(self, raised: Any) -> None:
        if raised.exc_type is not KeyboardInterrupt:
            self._hook(raised)

    def _interrupt(self, *_: object) -> None:
        self.asked = True
        raise KeyboardInterrupt


def _outcome(error: BaseException) -> tuple[int, str]:  # noqa: PLR0911  # one for each kind
    import typer

    from truejoint.cli.commands import COMMANDS
    from truejoint.errors import TruejointError
    from truejoint.files import reason

    # Words that are no option, command or value; typer does not export it.
    usage_error: Any = typer.BadParameter.__base__
    match error:
        case KeyboardInterrupt() | typer.Abort():
            return INTERRUPTED, ""
        case usage_error():
            what = " ".join(error.format_message().split())
            # An option without its value does not say which command it is of.
            begins = {" ".join(["truejoint", *sys.argv[1:n]]) for n in (1, 2, 3)}
            commands = begins & {f"truejoint {name}" for name in COMMANDS}
            line = max(commands, key=len, default="truejoint")
            where = error.ctx.command_path if error.ctx else line
            # An empty one means that help was shown.
            end = "" if what.endswith((".", "?")) else "."
            return FAILED, f"{what}{end} See `{where} --help`." if what else ""
        case TruejointError():
            return FAILED, str(error)
        case MemoryError():
            return FAILED, "takes more memory than there is; close other programs, or give it less"
        case BrokenPipeError():
            # Nobody reads it any more: write to nowhere, so that the interpreter does not complain.
            with open(os.devnull, "w") as nowhere:  # noqa: PTH123
                os.dup2(nowhere.fileno(), 1)
            return FAILED, ""
        case OSError():
            return FAILED, f"{error.filename or 'file'}: {reason(error)}"
    kind = type(error).__name__
    return FAULTY, (
        f"{kind}: {error}. This is a fault of truejoint, not of yours: please report it with the "
        f"command and what it prints with {DEBUG}"
    )
