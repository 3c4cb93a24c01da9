"""Quantities as a person reads them."""

import math

import pytest

from truejoint.units import DisplayUnit, display_unit, plural, shown, shown_range, with_unit


def test_a_unit_is_shown_as_people_have_it() -> None:
    assert display_unit("m") == DisplayUnit("mm", 1e3)
    assert display_unit("Nm") == DisplayUnit("Nm", 1.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (with_unit(0.002, "m"), "2.000 mm"),
        (with_unit(0.01, "rad"), "0.573 deg"),
        (with_unit(math.nan, "rad"), "-"),
        (shown(0.0125, "m"), "12.5 mm"),
        (shown_range(0.0, 0.0125, "m"), "[0, 12.5] mm"),
        (plural(1, "recording"), "1 recording"),
        (plural(2, "recording"), "2 recordings"),
    ],
)
def test_a_quantity_is_written(text: str, expected: str) -> None:
    assert text == expected
