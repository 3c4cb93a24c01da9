"""`truejoint columns`: write a column map to start from for somebody's file."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import truejoint
from truejoint.cli import options
from truejoint.cli.console import out
from truejoint.errors import RecordingError, printable
from truejoint.files import check_target, write_atomically


def columns(path: Path, robot: str = "", output: Path | None = None, force: bool = False) -> None:
    """Write a column map for a file, its columns guessed by their names, for you to mend.

    Other commands take it with `--columns`.
    """
    if output is not None:
        check_target(output, overwrite=force)
    text = truejoint.recordings.sketch_column_map(path, *options.robot_and_arm(robot)) + "\n"
    if output is None:
        out.print(text, end="", soft_wrap=True)
    else:
        write = partial(Path.write_text, data=printable(text), encoding="utf-8")
        write_atomically(output, write, overwrite=force, error=RecordingError)
        out.print(f"{output}: mend it, then give it with --columns")
