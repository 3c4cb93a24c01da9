"""Sentences that a user reads keep to CONTRIBUTING's rules.

These are the pages, the help texts, the messages of errors, and the docstrings of public names.
"""

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "truejoint"
CLI = SOURCE / "cli"
MADE = ("commands", "claims", "results")  # pages that a command writes
BY_HAND = [page.name for page in sorted((ROOT / "docs").glob("*.md")) if page.stem not in MADE]
PAGES = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    *(f"docs/{name}" for name in (*BY_HAND, "results/page.md")),
]
LONGEST = 28  # words
LINES_OF_A_TASK = 120
WORDS_OF_THE_MANUAL = 26_000
UNREAD = ("Examples", "References", "Raises")  # sections of a docstring that are no sentences
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
                elif len(place) == 2:  # a section's option of which the help is all, a hint
                    texts[".".join((*place, key))] = value
    return texts


def literal(node: ast.expr) -> str:
    """Text of a message, with a letter in place of each value."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(literal(part) or "x" for part in node.values)
    if isinstance(node, ast.BinOp):
        return literal(node.left) + literal(node.right)
    return ""


def messages(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of what errors and warnings say; after a semicolon stands the remedy."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
            name = node.func.id if isinstance(node.func, ast.Name) else called
            if name.endswith(("Error", "Refused", "Stopped")) or name == "warn":
                for argument in node.args:
                    yield node.lineno, literal(argument).replace("; ", ".\n\n")


@cache
def parsed(path: Path) -> ast.Module:
    """Syntax of a module, which two tests read."""
    return ast.parse(path.read_text("utf-8"))


def public_names() -> dict[Path, set[str]]:
    """Names that packages export, by the file that defines them."""
    names: dict[Path, set[str]] = {}
    for stub in SOURCE.rglob("__init__.pyi"):
        for node in ast.parse(stub.read_text("utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module:
                file = stub.parent.joinpath(*node.module.split(".")).with_suffix(".py")
                if file.exists():
                    names.setdefault(file, set()).update(each.name for each in node.names)
    return names


def prose(docstring: str) -> str:
    """Sentences of a numpydoc text, without examples, asides and names of parameters."""
    kept, lines = [], docstring.splitlines() or [""]
    heading, section = "", ""
    for line, after in zip(lines, [*lines[1:], ""], strict=True):
        if re.fullmatch("-{3,}", after):
            heading, line = line, ""  # noqa: PLW2901
        section = heading
        if section not in UNREAD and not line.startswith((">>>", "---")):
            kept.append("" if re.match(r"\S[^.]* : ", line) else line)
    text = re.sub(r"``[^`]*``", "code", "\n".join(kept)).replace("; ", ".\n\n")
    return re.sub(r"\([^()]*\)", "", text)


def documented(tree: ast.Module, names: set[str]) -> Iterator[tuple[str, str]]:
    """Name and docstring of what a module exports, and of its public methods."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name in names:
            inner = node.body if isinstance(node, ast.ClassDef) else []
            methods = (each for each in inner if isinstance(each, ast.FunctionDef))
            for each in (node, *(each for each in methods if each.name[0] != "_")):
                yield each.name, ast.get_docstring(each) or ""


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


def test_messages_of_errors_are_in_plain_english() -> None:
    wrong, number = {}, 0
    for path in sorted(SOURCE.rglob("*.py")):
        for line, text in messages(parsed(path)):
            number += 1
            for each in sentences(text):
                if rules := broken_rules(each):
                    wrong[f"{path.relative_to(SOURCE)}:{line}", each] = rules
    assert not wrong
    assert number > 700


def test_docstrings_of_public_names_are_in_plain_english() -> None:
    wrong, number = {}, 0
    for path, names in public_names().items():
        for name, text in documented(parsed(path), names):
            number += 1
            for each in sentences(prose(text)):
                if rules := broken_rules(each):
                    wrong[f"{path.relative_to(SOURCE)}: {name}", each] = rules
    assert not wrong
    assert number > 500


def test_a_message_and_a_docstring_are_read_as_sentences() -> None:
    said = 'raise TruejointError(f"{path}: " "it is none of its own; " + "Of two, take one")'
    ((line, text),) = messages(ast.parse(said))
    found = [rule for each in sentences(text) for rule in broken_rules(each)]
    assert (line, found) == (1, ["says 'is none'", "says 'of its own'", "begins with Of"])
    sections = "Parameters\n    ----------\n    x : float\n        Of it.\n    "
    code = f'def f(x):\n    """Give x.\n\n    {sections}"""'
    (known,) = documented(ast.parse(code), {"f"})
    assert [each for each in sentences(prose(known[1])) if broken_rules(each)] == ["Of it."]


def test_the_manual_is_short() -> None:
    texts = {name: (ROOT / "docs" / name).read_text("utf-8") for name in BY_HAND}
    words = sum(len(re.findall(r"[A-Za-z][\w'-]*", text)) for text in texts.values())
    assert words <= WORDS_OF_THE_MANUAL
    tasks = re.findall(r"^(\w+)$", texts["how_to.md"], flags=re.MULTILINE)
    tasks = [task for task in ("first_steps", *tasks) if task not in MADE]
    lines = {f"{task}.md": texts[f"{task}.md"].count("\n") for task in tasks}
    assert {name: number for name, number in lines.items() if number > LINES_OF_A_TASK} == {}


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
