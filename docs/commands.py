"""Write docs/commands.md: every command with its options, from the command line itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from truejoint.cli.commands import COMMANDS, command

PAGE = Path(__file__).with_name("commands.md")


def spelt(parameter: Any) -> str:
    """Option or argument as it is typed."""
    names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    if not parameter.opts[0].startswith("-"):
        return f"`{(parameter.metavar or parameter.name).upper()}`"
    kind = parameter.metavar or ("" if parameter.is_flag else "VALUE")
    return f"{names} `{kind}`" if kind else names


def page() -> str:
    """Write out the whole page."""
    lines = [
        "# Commands", "",
        "`python docs/commands.py` writes this page from the command line itself.", "",
    ]  # fmt: skip
    for panel in dict.fromkeys(entry.panel for entry in COMMANDS.values()):
        lines += [f"## {panel}", ""]
        for name in (name for name, entry in COMMANDS.items() if entry.panel == panel):
            made = command(name)
            about = " ".join((made.help or "").split())
            lines += [f"### `truejoint {name}`", "", about, "", "```sh"]
            lines += [f"truejoint {name} {COMMANDS[name].example}".strip(), "```", ""]
            lines += ["| option | meaning |", "|---|---|"]
            for parameter in made.params:
                text = " ".join((getattr(parameter, "help", "") or "").split()).replace("|", "\\|")
                if parameter.default not in (None, False, "", ()) and "default" not in text:
                    text = f"{text.removesuffix('.')} (default {parameter.default})."
                typed = spelt(parameter).replace("|", "\\|")
                if parameter.name != "help":
                    lines.append(f"| {typed} | {text} |")
            lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
