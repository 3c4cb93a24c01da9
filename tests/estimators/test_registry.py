"""Estimators by name: one place knows the names."""

import ast
import re
from pathlib import Path

import pytest
from tests.refusals import refused

import truejoint
from truejoint.estimators import (
    CableLeastSquares,
    JawFilter,
    JawPlays,
    Polynomial,
    candidates,
    estimator_names,
    get_estimator,
)
from truejoint.estimators.registry import OWN, PRESETS

SOURCE = Path(truejoint.__file__).parent
# The registry itself; what a user reads or types; what suits a data set; what a study compares.
NAMING = ("estimators/registry.py", "cli/", "recordings/datasets/", "studies/")
WORDS = {"offset", "linear", "hybrid", "gp"}
"""Names that are words of their own, also of arrays, families and of text."""


def test_an_unknown_name_is_refused_with_the_known_and_the_nearest():
    refused(r"'tree'; .*offset, linear, poly2, dnn", get_estimator, "tree")
    refused("'poly'; did you mean 'poly2'", get_estimator, "poly")


@pytest.mark.parametrize(
    ("estimator", "name"),
    [
        (Polynomial(1), "linear"),
        (Polynomial(3), "polynomial"),
        (JawFilter(slider_mass=2.0), "ukf"),
        (JawFilter(compensated=True), "ukf_compensated"),
        (JawPlays(signals=("cable/reset",), penalty=1.0), "play_reset"),
        (JawPlays(signals=("motor/jaw", "cable/drive")), "plays.jaw_bank"),
        (CableLeastSquares(intercept=True, compensated=True), "jaw.least_squares"),
    ],
    ids=str,
)
def test_an_estimator_is_called_as_it_is_registered_or_else_by_its_family(estimator, name):
    assert estimator.name == name


def strings(source: str) -> list[tuple[int, str]]:
    """Line and value of every text in a module but its docstrings."""
    tree = ast.parse(source)
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docs = {id(node.body[0].value) for node in ast.walk(tree)
            if isinstance(node, documented) and isinstance(node.body[0], ast.Expr)}  # fmt: skip
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs
    ]


def test_nothing_else_names_an_estimator():
    names = set(estimator_names()) - WORDS
    read = {
        path.relative_to(SOURCE).as_posix(): path.read_text("utf-8")
        for path in sorted(SOURCE.rglob("*.py"))
    }
    anyhow = re.compile("|".join(names))  # parsing every module takes a second
    found = [
        f"{path}:{line}: {text}"
        for path, source in read.items()
        if not path.startswith(NAMING) and anyhow.search(source)
        for line, text in strings(source)
        if names & set(text.replace(":", " ").replace(",", " ").split())
    ]
    assert len(read) > 200
    assert not found


def test_the_page_of_estimators_says_of_each_how_it_runs() -> None:
    page = Path(__file__).parents[2] / "docs" / "estimators.md"
    lines = re.findall(r"^\| (`.*) \|$", page.read_text("utf-8"), flags=re.MULTILINE)
    rows = [line.split(" | ") for line in lines if line.count(" | ") == 6]
    said = {name: row[3:] for row in rows for name in re.findall(r"`(\w+)`", row[0])}
    about = {
        name: {"what": re.sub(r"\[(.*?)\]\(.*?\)|; .*", r"\1", row[1]), "sees": row[3]}
        for row in rows
        for name in re.findall(r"`(\w+)`", row[0])
    }
    assert about == {n: {"what": p.what, "sees": p.sees} for n, p in PRESETS.items()}
    automatic = {estimator.name for estimator in candidates()}
    found = {}
    for name in OWN:
        estimator = get_estimator(name)
        family = estimator.family
        found[name] = (
            family.counts_samples,
            name in automatic,
            "in the loop, in C" if family.row is not None else "on recordings",
            "its own"
            if family.states_deviation(estimator.model_params())
            else "of the calibration",
        )
    assert found == {
        name: ("by samples" in sees, auto.startswith("yes"), runs, half_width)
        for name, (sees, auto, runs, half_width) in said.items()
    }
