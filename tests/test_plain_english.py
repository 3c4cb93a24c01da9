"""Sentences that a user reads keep to CONTRIBUTING's rules: help texts and every page."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CLI = ROOT / "src" / "truejoint" / "cli"
BY_HAND = [page.name for page in sorted((ROOT / "docs").glob("*.md")) if page.stem != "commands"]
PAGES = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    *(f"docs/{name}" for name in BY_HAND),
]
LONGEST = 28  # words
BEGINNINGS = re.compile(r"(Of|What|Where|That|Who|From|Whose)\b(?!.*\?$)")
PHRASES = re.compile(
    r"\b(is none|is told|is said|are told|are said|goes on all the same|of its own|as it comes|"
    r"all the same|one's own|the like)\b",
    re.IGNORECASE,
)


def sentences(text: str) -> Iterator[str]:
    """Sentences of a page or a help text, without code, tables, links and headings."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    lines = [
        "" if re.match(r"\s*(\||#|!\[)", line) else re.sub(r"^\s*[-*] ", "\n\n", line)
        for line in text.splitlines()
    ]
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(lines))
    text = re.sub(r"`[^`]*`", "code", text)
    for paragraph in re.split(r"\n\s*\n", text):
        for part in re.split(r"(?<!al)(?<=[.!?:])\**\s+", " ".join(paragraph.split())):
            if part:
                yield part.strip("* ")


def broken_rules(sentence: str) -> list[str]:
    """Rules that a sentence breaks."""
    words = re.findall(r"[A-Za-z][\w'-]*", sentence)
    return [
        *([f"{len(words)} words"] if len(words) > LONGEST else []),
        *([f"begins with {m[1]}"] if (m := BEGINNINGS.match(sentence)) else []),
        *[f"says '{m[1]}'" for m in PHRASES.finditer(sentence)],
    ]


def help_texts() -> dict[str, str]:
    """Help of every option and command, by where it stands."""
    texts = {}
    for name in ("help.toml", "commands.toml"):
        pages = [((name,), tomllib.loads((CLI / name).read_text("utf-8")))]
        while pages:
            place, page = pages.pop()
            for key, value in page.items():
                if isinstance(value, dict):
                    pages.append(((*place, key), value))
                elif key in ("help", "summary"):
                    texts[".".join(place)] = value
    return texts


@pytest.mark.parametrize("page", PAGES)
def test_pages_are_in_plain_english(page: str) -> None:
    text = (ROOT / page).read_text("utf-8")
    wrong = {each: rules for each in sentences(text) if (rules := broken_rules(each))}
    assert not wrong


def test_help_texts_are_in_plain_english() -> None:
    wrong = {
        (place, each): rules
        for place, text in help_texts().items()
        for each in sentences(text)
        if (rules := broken_rules(each))
    }
    assert not wrong


@pytest.mark.parametrize(
    ("sentence", "rule"),
    [
        ("Where there is one, it counts.", "begins with Where"),
        ("A value that is told.", "says 'is told'"),
        (" ".join(["word"] * 29), "29 words"),
        ("truejoint warns and continues.", None),
        ("Where does it hold?", None),
    ],
)
def test_a_sentence_that_breaks_a_rule_is_found(sentence: str, rule: str | None) -> None:
    assert broken_rules(sentence) == ([rule] if rule else [])
