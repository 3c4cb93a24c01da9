"""Measurements of speed, the loop and faults; see docs/results.md. Nothing passes or fails."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any


def stored(out: Path, title: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Give what `make` gives, from its file in a folder where there is one."""
    path = out / f"{title.replace(', ', '-').replace(' ', '_')}.json"
    if not path.exists():
        out.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(make()))
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def parsed(doc: str, **defaults: Any) -> argparse.Namespace:
    """Read the options of a command line, each of the kind of its default.

    A tuple is what there is to choose from, all of it by default; a list may hold anything.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    for name, default in defaults.items():
        how: dict[str, Any] = {"default": default}
        if isinstance(default, bool):
            how["action"] = "store_true"
        elif isinstance(default, list | tuple):
            how |= {"nargs": "+", "type": type(default[0])}
            how |= {"choices": default} if isinstance(default, tuple) else {}
        else:
            how["type"] = type(default)
        parser.add_argument(f"--{name.replace('_', '-')}", **how)
    return parser.parse_args()


def head(*names: str) -> None:
    """Print the head of a Markdown table."""
    print(f"| {' | '.join(names)} |\n|{'---|' * len(names)}", flush=True)


def row(*cells: object) -> None:
    """Print a row of a Markdown table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)
