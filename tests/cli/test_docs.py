"""What README and docs show is there: commands with their options, benchmarks, pages."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from truejoint.cli.app import _spelt_out
from truejoint.cli.commands import built

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def shown(text: str) -> Iterator[str]:
    """Commands in a page's blocks and lines."""
    for block in re.findall(r"```(?:sh)?\n(.*?)```", text, flags=re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("truejoint "):
                yield re.split(r"\s[#&]|\s\.\.\.", line)[0]
    for line in re.findall(r"`(truejoint [^`]+)`", text):
        yield line.replace("\n", " ")


def unknown(line: str) -> list[str]:
    """Words of a command that it does not know."""
    command: Any = built()
    words = _spelt_out(shlex.split(line)[1:])
    while words and hasattr(command, "commands"):
        name = words.pop(0)
        if name not in command.commands:
            return [] if name.startswith("-") or name.isupper() else [name]
        command = command.commands[name]
    known = {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
    given = [word.strip("[]").partition("=")[0] for word in words]
    return [word for word in given if re.match("-[-a-z]", word) and word not in known]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_of_the_docs_are_known(page: Path) -> None:
    wrong = {line: found for line in shown(page.read_text("utf-8")) if (found := unknown(line))}
    assert not wrong


def test_what_is_no_command_or_option_is_found() -> None:
    assert unknown("truejoint calibrat run.csv") == ["calibrat"]
    assert unknown("truejoint calibrate run.csv --feture a -o m.st [--arm left]") == ["--feture"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages_and_benchmarks_of_the_docs_are_there(page: Path) -> None:
    text = page.read_text("utf-8")
    links = {link.partition("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text)}
    own = [link for link in links if link and not link.startswith("http")]
    assert [link for link in own if not (page.parent / link).exists()] == []
    modules = set(re.findall(r"python -m (benchmarks(?:\.\w+)?)", text))
    files = {name: ROOT.joinpath(*name.split(".")) for name in modules}
    there = [n for n, file in files.items() if file.is_dir() or file.with_suffix(".py").exists()]
    assert sorted(there) == sorted(modules)


def test_every_page_is_linked_from_another() -> None:
    texts = {page: page.read_text("utf-8") for page in PAGES}
    links = {
        page: {link.rpartition("/")[2] for link in re.findall(r"\]\(([^)#\s]+)", text)}
        for page, text in texts.items()
    }
    for page in PAGES[1:]:
        assert any(page.name in found for other, found in links.items() if other != page), page.name
