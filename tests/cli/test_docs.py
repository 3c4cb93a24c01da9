"""What README and docs show is there: commands with their options, benchmarks, pages."""

import importlib.util
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from truejoint.cli.commands import COMMANDS, GROUPS, HINTS, command

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
    words = shlex.split(line)[1:]
    names = {" ".join(words[:n]) for n in range(3)} & {"", *COMMANDS, *GROUPS}
    name = max(names, key=len)
    rest = words[len(name.split()) :]
    if name not in COMMANDS:
        return [word for word in rest[:1] if not (word.startswith("-") or word.isupper())]
    parameters = command(name).params
    known = {o for p in parameters for o in (*p.opts, *p.secondary_opts)} | {"--help"}
    given = [word.strip("[]").partition("=")[0] for word in rest]
    return [word for word in given if re.match("-[-a-z]", word) and word not in known]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_of_the_docs_are_known(page: Path) -> None:
    wrong = {line: found for line in shown(page.read_text("utf-8")) if (found := unknown(line))}
    assert not wrong


@pytest.mark.parametrize("name", ["commands", "results"])
def test_a_page_that_a_command_writes_is_up_to_date(name: str) -> None:
    path = ROOT / "docs" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"{name}_page", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert path.with_suffix(".md").read_text("utf-8") == module.page(), f"run: docs/{name}.py"


def test_what_is_no_command_or_option_is_found() -> None:
    assert unknown("truejoint calibrat run.csv") == ["calibrat"]
    assert unknown("truejoint calibrate run.csv --feture a -o m.st [--robot left]") == ["--feture"]


@pytest.mark.parametrize("word", HINTS)
def test_a_hint_leads_to_a_command_that_is_there(word: str) -> None:
    hinted = [*shown(HINTS[word])]
    assert hinted
    assert not any(unknown(line) for line in hinted)
    assert word not in COMMANDS


def test_what_there_is_to_learn_stays_within_its_size() -> None:
    options = [p for name in COMMANDS for p in command(name).params if p.opts[0].startswith("-")]
    assert len(COMMANDS) <= 28
    assert len([option for option in options if option.name != "help"]) <= 250


def anchors(text: str) -> set[str]:
    """Give what a link can point to in a page: its headings, as GitHub and GitLab write them."""
    bare = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    headings = re.findall(r"^#+ (.+)$", bare, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_a_heading_is_an_anchor() -> None:
    text = "# Which one: `-e auto`\n```\n# no heading\n```\n### 2 s of truth, judged\n"
    assert anchors(text) == {"which-one--e-auto", "2-s-of-truth-judged"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_of_the_docs_lead_somewhere(page: Path) -> None:
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        name, _, anchor = link.partition("#")
        there = page.parent / name if name else page
        if not name.startswith("http") and not (
            there.exists() and (not anchor or anchor in anchors(there.read_text("utf-8")))
        ):
            wrong.append(link)
    assert not wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_benchmarks_of_the_docs_are_there_with_their_options(page: Path) -> None:
    text = re.sub(r"\s+", " ", page.read_text("utf-8"))
    shown = re.findall(r"python -m (benchmarks(?:\.\w+)?)([^`|]*)", text)
    sources = {name: ROOT.joinpath(*name.split(".")) for name, _ in shown}
    for name, rest in shown:
        source = sources[name]
        file = source / "__main__.py" if source.is_dir() else source.with_suffix(".py")
        assert file.exists(), name
        options = re.findall(r"(?<!\S)--[a-z-]+", rest.partition("```")[0])
        source = file.read_text("utf-8")
        taken = {option: f"{option[2:].replace('-', '_')}=" for option in options}
        unknown = [o for o, kw in taken.items() if f'"{o}"' not in source and kw not in source]
        assert unknown == [], name


def test_every_page_is_linked_from_another() -> None:
    texts = {page: page.read_text("utf-8") for page in PAGES}
    links = {
        page: {link.rpartition("/")[2] for link in re.findall(r"\]\(([^)#\s]+)", text)}
        for page, text in texts.items()
    }
    for page in PAGES[1:]:
        assert any(page.name in found for other, found in links.items() if other != page), page.name


def test_pages_that_the_software_names_are_there() -> None:
    for path in (ROOT / "src").rglob("*.*"):
        if path.suffix in {".py", ".j2", ".toml"}:
            named = re.findall(r"docs/\w+\.md", path.read_text("utf-8"))
            assert not [page for page in named if not (ROOT / page).is_file()], path
