"""What errors say, and what of anyone's text a person may see."""

import pytest

from truejoint.errors import meant, other_kind, printable, shown_text, unknown, words


@pytest.mark.parametrize(
    ("name", "choices", "question"),
    [
        ("elbo", ["shoulder", "elbow"], " did you mean 'elbow'?"),
        ("420171", ["420179", "420172"], " did you mean '420172'?"),  # of as long ones, the nearest
        ("jaw", ["shoulder", "elbow"], ""),
    ],
)
def test_the_name_that_is_meant(name: str, choices: list[str], question: str) -> None:
    assert meant(name, choices) == question
    assert unknown("joint", name, choices) == (
        f"no joint called {name!r};{question} known: {', '.join(choices)}"
    )


def test_what_could_steer_a_terminal_becomes_an_escape() -> None:
    assert printable("run\x1b[31m\udcff.csv") == r"run\x1b[31m\xff.csv"
    assert shown_text("run\x1b[31m.csv") == r"run\x1b[31m.csv"
    assert shown_text(1.5) == 1.5


def test_an_error_says_one_line() -> None:
    assert words(OSError("cut\nshort")) == "cut short"
    assert words(AssertionError()) == "AssertionError"
    said = other_kind("raven2", "Robot", "get_robot(name) gives one")
    assert said == "'raven2' is a str, not a Robot; get_robot(name) gives one"
