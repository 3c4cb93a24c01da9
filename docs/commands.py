"""Write docs/commands.md: every command with its options, from the command line itself."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, Final

from truejoint.cli.commands import COMMANDS, command

PAGE: Final = Path(__file__).with_name("commands.md")
OFTEN: Final = 4  # commands that take an option alike, for it to stand above them all
HEADER: Final = ("| option | meaning |", "|---|---|")


def spelt(parameter: Any) -> str:
    """Option or argument as it is typed."""
    names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    if not parameter.opts[0].startswith("-"):
        return f"`{(parameter.metavar or parameter.name).upper()}`"
    kind = parameter.metavar or ("" if parameter.is_flag else "VALUE")
    return f"{names} `{kind}`" if kind else names


def row(parameter: Any) -> str:
    """Give the line of an option or argument in a table: how it is typed, and what it means."""
    text = " ".join((getattr(parameter, "help", "") or "").split())
    if parameter.default not in (None, False, "", ()) and "default" not in text:
        text = f"{text.removesuffix('.')} (default {parameter.default})."
    return "| {} | {} |".format(*(each.replace("|", "\\|") for each in (spelt(parameter), text)))


def page() -> str:
    """Write out the whole page."""
    made = {name: command(name) for name in COMMANDS}
    rows = {
        name: [row(each) for each in cmd.params if each.name != "help"]
        for name, cmd in made.items()
    }
    often = Counter(line for lines in rows.values() for line in lines if line.startswith("| `-"))
    first = {line.split("`")[1]: line for line, times in reversed(often.most_common())}
    alike = {line for line in first.values() if often[line] >= OFTEN}
    lines = [
        "# Commands", "",
        "`python docs/commands.py` writes this page from the command line itself.", "",
        "## Options of many commands", "", *HEADER, *sorted(alike), "",
    ]  # fmt: skip
    for panel in dict.fromkeys(entry.panel for entry in COMMANDS.values()):
        lines += [f"## {panel}", ""]
        for name in (name for name, entry in COMMANDS.items() if entry.panel == panel):
            about = " ".join((made[name].help or "").split())
            lines += [f"### `truejoint {name}`", "", about, "", "```sh"]
            lines += [f"truejoint {name} {COMMANDS[name].example}".strip(), "```", ""]
            lines += [*HEADER, *(line for line in rows[name] if line not in alike), ""]
            also = ", ".join(f"`{line.split('`')[1]}`" for line in rows[name] if line in alike)
            lines += [f"Also {also}.", ""] if also else []
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
