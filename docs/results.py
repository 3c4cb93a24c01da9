"""Write docs/results.md, and README's table, from the stored outputs in docs/results/.

    python docs/results.py                                # both anew
    python docs/results.py studies/*/*.json bench/*.md    # with these in place of the stored
    python docs/results.py NAME=studies/timing/timing.json    # stored by another name

A stored output holds tables of texts and the command that made them: of ``truejoint study`` its
JSON without the rows, of ``make bench`` the tables of its Markdown. ``docs/results/page.md`` says
where each stands: a line ``{{name}}`` is replaced by the tables of ``docs/results/name.json``, and
``{{name|median|worst}}`` by those with one of these words in the title.
"""

from __future__ import annotations

import json
import re
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

DOCS: Final = Path(__file__).parent
STORED: Final = DOCS / "results"
PAGE: Final = DOCS / "results.md"
README: Final = DOCS.parent / "README.md"
README_TABLE: Final = re.compile(r"^\| data set, .*?\n\n", re.DOTALL | re.MULTILINE)
COLUMNS: Final = {
    "raw": "raw", "offset": "fixed offset", "linear": "linear", "dnn": "network",
    "auto": "`-e auto`",
}  # fmt: skip
"""Columns of README's table, by those of the study `real`."""
HELD_OUT: Final = {
    "davinci_grasper_umn, frequency": "da Vinci grasper, one frequency",
    "davinci_grasper_umn, load": "da Vinci grasper, two loads",
    "dvrk_psm_berkeley, random": "dVRK PSM `random`, last 30 %",
    "bros_dual_encoder, part": "BROS haptic arm, second file",
    "kuka_kr300_dual_encoder, trajectory": "KUKA KR300, second motion",
    "kflex_tendon_sheath, period": "K-FLEX tendon sheath, last half",
}
"""Rows of README's table, by the data set and split of the study `real`."""
RULE: Final = "A claim holds, or does not"  # of claims, which stand on a page of their own


def of_study(path: Path) -> dict[str, Any]:
    """Read tables and origin of what a study left."""
    result = json.loads(path.read_text("utf-8"))
    origin = {key: result["origin"][key] for key in ("command", "created", "source")}
    origin["command"] = re.sub(r" ((--jobs|--out|-o) \S+|--force)", "", origin["command"])
    keys = ("title", "header", "rows", "notes")
    return {"origin": origin, "tables": [{key: t[key] for key in keys} for t in result["tables"]]}


def of_benchmark(path: Path) -> dict[str, Any]:
    """Read the tables of what a benchmark printed, each under the line before it."""
    tables: list[dict[str, Any]] = []
    before, rows = "", []
    for line in [*path.read_text("utf-8").splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip("|").split("|")])
        elif rows:
            tables.append({"title": before, "header": rows[0], "rows": rows[2:], "notes": []})
            before, rows = "", []
        if line.strip() and not line.startswith("|"):
            before = line.strip("*#: ")
    created = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    command = f"python -m benchmarks.{path.stem}"
    return {"origin": {"command": command, "created": f"{created:%Y-%m-%d}"}, "tables": tables}


def store(name: str, output: dict[str, Any]) -> None:
    """Keep an output, a line for each row."""
    text = json.dumps(output, indent=1, ensure_ascii=False)
    row = re.compile(r"\[\s+(\"(?:[^\"\\]|\\.)*\"(?:,\s+\"(?:[^\"\\]|\\.)*\")*)\s+\]")
    text = row.sub(lambda m: "[" + re.sub(r"\s*\n\s*", " ", m[1]) + "]", text)
    (STORED / f"{name}.json").write_text(text + "\n", "utf-8")


def stored(name: str) -> dict[str, Any]:
    """Read a stored output."""
    return json.loads((STORED / f"{name}.json").read_text("utf-8"))  # type: ignore[no-any-return]


def lines_of(table: dict[str, Any]) -> list[str]:
    """Write a table as Markdown."""
    cells = [table["header"], ["---"] * len(table["header"]), *table["rows"]]
    return ["| " + " | ".join(row) + " |" for row in cells]


def section(name: str, *chosen: str) -> str:
    """Write the tables of an output, all or those chosen, with the command that makes them."""
    output = stored(name)
    origin, lines = output["origin"], []
    for table in output["tables"]:
        if chosen and not any(words in table["title"] for words in chosen):
            continue
        lines += [f"**{table['title']}**", ""] if table["title"] else []
        lines += [*lines_of(table), ""]
        for note in table["notes"]:
            lines += [] if note.startswith(RULE) else [note, ""]
    day = origin["created"][:10]
    commands = " and ".join(f"`{each}`" for each in origin["command"].split(" && ") if each)
    return "\n".join([*lines, f"{commands}, {day}."])


def page() -> str:
    """Write out the page of results."""
    text = (STORED / "page.md").read_text("utf-8")
    return re.sub(r"^\{\{(.+)\}\}$", lambda m: section(*m[1].split("|")), text, flags=re.MULTILINE)


def readme() -> str:
    """Write README with the table of real recordings as it is stored."""
    table = stored("real")["tables"][0]
    at = [table["header"].index(column) for column in COLUMNS]
    rows = []
    for row in table["rows"]:
        name, joint = row[0].split(": ")
        if name in HELD_OUT:
            rows.append([HELD_OUT[name], joint, *(row[k].split(" ±")[0] for k in at)])
    header = ["data set, what is held out", "joint", *COLUMNS.values()]
    lines = lines_of({"header": header, "rows": rows})
    return README_TABLE.sub(lambda _: "\n".join(lines) + "\n\n", README.read_text("utf-8"))


def main(paths: list[str]) -> None:
    """Take over the outputs of these files, and write both pages."""
    on_page = re.findall(r"^\{\{([\w-]+)", (STORED / "page.md").read_text("utf-8"), re.MULTILINE)
    for given in paths:
        name, _, file = given.rpartition("=")
        path, name = Path(file), name or Path(file).stem
        output = of_study(path) if path.suffix == ".json" else of_benchmark(path)
        if name not in on_page:
            print(f"{given}: the page shows no {name}")  # noqa: T201
        elif name == "real" and not {*COLUMNS} <= {*output["tables"][0]["header"]}:
            print(f"{given}: lacks a column of {', '.join(COLUMNS)}")  # noqa: T201
        else:
            store(name, output)
    PAGE.write_text(page(), "utf-8")
    README.write_text(readme(), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
