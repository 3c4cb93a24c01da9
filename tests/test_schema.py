"""Tables of plain values become checked values, and every broken rule is one line."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint import schema
from truejoint.array_types import Array
from truejoint.errors import RobotError, TruejointError
from truejoint.schema import Bounds, Choice, Key, Length, Ordered, Shape

Point = Annotated[Array, Shape((3,)), Bounds(-1e3, 1e3)]


@dataclass(frozen=True)
class Wheel:
    SHORT: ClassVar[str] = "radius"

    radius: schema.Positive
    teeth: Annotated[int, Bounds(1, 100)] = 20

    def __post_init__(self) -> None:
        if self.teeth == 13:
            raise RobotError("13 teeth; want another number")


class Pose(NamedTuple):
    rotation: Annotated[Array, Shape((None, 3))]
    unit: Annotated[str, Choice(("mm", "m"))] = "m"


@dataclass(frozen=True)
class Gear:
    name: schema.Name
    wheels: Annotated[Mapping[str, Wheel], Ordered(), Length(1, 3)]
    ratio: float = 1.0
    ends: tuple[float, bool] = (0.0, True)
    shares: Annotated[tuple[float, ...], Bounds(0.0, 1.0), Length(0, 2)] = ()
    sign: Literal[1, -1] = 1
    side: Literal["left", "right"] = "left"
    pose: Pose | None = None
    column: str | int = 0
    points: Annotated[Mapping[str, Point], Key("points_mm", 1e-3)] = field(default_factory=dict)
    radii: Annotated[Mapping[str, float], Ordered("radius")] = field(default_factory=dict)
    rate: float = np.nan
    notes: Any = None


FULL: dict[str, Any] = {
    "name": "elbow",
    "wheels": {"in": {"radius": 1}, "out": 0.5},
    "ratio": 3,
    "ends": [1, False],
    "shares": [0.25, 1],
    "sign": -1,
    "side": "right",
    "pose": {"rotation": [[1, 0, 0], [0, 1, 0]], "unit": "mm"},
    "column": "angle",
    "points_mm": {"1": [1, 2, 3]},
    "radii": [{"name": "a", "radius": 2.0}, {"name": "b", "radius": 1.0}],
    "notes": ["anything"],
}


def test_a_full_table_is_read() -> None:
    gear = schema.read(Gear, FULL, "gear.toml")
    assert gear.wheels == {"in": Wheel(1.0), "out": Wheel(0.5)}
    assert type(gear.wheels["in"].radius) is float
    assert gear.ends == (1.0, False)
    assert (gear.sign, gear.side, gear.column, gear.notes) == (-1, "right", "angle", ["anything"])
    assert gear.pose is not None
    assert gear.pose.rotation.tolist() == [[1, 0, 0], [0, 1, 0]]
    assert np.allclose(gear.points["1"], [1e-3, 2e-3, 3e-3], rtol=1e-15)
    assert gear.radii == {"a": 2.0, "b": 1.0}
    assert list(gear.radii) == ["a", "b"]


def test_what_is_written_is_read_again() -> None:
    gear = schema.read(Gear, FULL, "gear.toml")
    written = schema.plain(gear)
    assert "rate" not in written
    assert written["wheels"][1] == {"name": "out", "radius": 0.5, "teeth": 20}
    assert written["radii"] == FULL["radii"]
    assert np.allclose(written["points_mm"]["1"], [1, 2, 3], rtol=1e-15)
    again = schema.read(Gear, written, "gear.toml")
    assert schema.plain(again) == written
    assert again.wheels == gear.wheels
    assert schema.plain(schema.read(Gear, {"name": "x", "wheels": {"a": 1}}, "")) == {
        "name": "x", "wheels": [{"name": "a", "radius": 1.0, "teeth": 20}], "ratio": 1.0,
        "ends": [0.0, True], "shares": [], "sign": 1, "side": "left", "column": 0,
        "points_mm": {}, "radii": [],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"nam": 1}, "no key called 'nam'; did you mean 'name'?"),
        ({"name": None}, "name is None; want up to 60 letters, digits and _"),
        ({"name": "a b"}, "name is 'a b'; want up to 60 letters"),
        ({"ratio": "3"}, "ratio is '3'; want a number"),
        ({"ratio": True}, "ratio is True; want a number"),
        ({"ratio": float("nan")}, "ratio is nan; want a number"),
        ({"ratio": float("inf")}, "ratio is inf; want a number"),
        ({"ratio": 10**400}, "ratio is 1000"),
        ({"wheels": {}}, "wheels has 0 keys; want 1 to 3"),
        ({"wheels": 3}, "wheels is 3; want a table"),
        ({"wheels": {"in": {"radius": 0}}}, "wheels.in.radius is 0; want a number above 0"),
        ({"wheels": {"in": {}}}, "wheels.in: 'radius' is missing; add it"),
        ({"wheels": {"in": [1]}}, "wheels.in is [1]; want a table"),
        ({"wheels": {"in": {"radius": 1, "teeth": 2.0}}}, "teeth is 2.0; want a whole number"),
        ({"wheels": {"a b": {"radius": 1, "teeth": 0}}}, "wheels.'a b'.teeth is 0; want a whole"),
        ({"wheels": {"in": {"radius": 1, "teeth": 13}}}, "wheels.in: 13 teeth; want another"),
        ({"wheels": [{"name": "a", "radius": 1}] * 2}, "wheels: 'a' stands twice; keep one"),
        ({"wheels": [{"radius": 1}]}, "wheels[0] is {'radius': 1}; want a table with a name"),
        ({"ends": [1]}, "ends has 1 entries; want 2"),
        ({"ends": [1, 2]}, "ends[1] is 2; want true or false"),
        ({"shares": 0.5}, "shares is 0.5; want a list"),
        ({"shares": [0, 1.1]}, "shares[1] is 1.1; want a number from 0 to 1"),
        ({"shares": [0, 0, 0]}, "shares has 3 entries; want 0 to 2"),
        ({"sign": 1.0}, "sign is 1.0; want 1 or -1"),
        ({"sign": True}, "sign is True; want 1 or -1"),
        ({"side": "up"}, "side is 'up'; want left or right"),
        ({"pose": {"rotation": [[1, 0]]}}, "pose.rotation is [[1, 0]]; want n x 3 numbers"),
        ({"pose": {"rotation": [[1, 0, True]]}}, "pose.rotation is [[1, 0, True]]; want"),
        ({"pose": {"rotation": [[1, 0, 10**400]]}}, "pose.rotation is [[1, 0, 1000"),
        ({"pose": {"rotation": [[1, 0], [1]]}}, "pose.rotation is [[1, 0], [1]]; want n x 3"),
        ({"pose": {"rotation": "abc"}}, "pose.rotation is 'abc'; want n x 3 numbers"),
        ({"pose": {"rotation": [["1", 0, 0]]}}, "want n x 3 numbers"),
        ({"pose": {"rotation": [[0, 0, 0]], "unit": "km"}}, "pose.unit is 'km'; want mm or m"),
        ({"pose": 1}, "pose is 1; want a table"),
        ({"column": [1]}, "column is [1]; want a whole number"),
        ({"points_mm": {"1": [0, 0, 1001]}}, "points_mm.'1' is [0, 0, 1001]; want 3 numbers from"),
    ],
)
def test_an_error_names_the_path_the_value_and_the_rule(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(RobotError) as fault:
        schema.read(Gear, {**FULL, **changes}, "gear.toml", RobotError)
    message = str(fault.value)
    assert message.startswith("gear.toml: ")
    assert text in message
    assert "\n" not in message


def test_a_table_that_is_none() -> None:
    with pytest.raises(TruejointError, match=r"^gear.toml is \[\]; want a table$"):
        schema.read(Gear, [], "gear.toml")


def test_a_schema_that_no_table_holds() -> None:
    @dataclass(frozen=True)
    class Odd:
        place: complex

    with pytest.raises(TypeError, match="complex"):
        schema.read(Odd, {"place": 1}, "odd")


PLAIN = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=4),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["name", "radius", "rotation", "1"]), inner, max_size=3)
    ),
    max_leaves=6,
)


@given(st.sampled_from(sorted(FULL)), PLAIN)
def test_any_value_is_read_or_refused_in_one_line(key: str, value: object) -> None:
    changed = {**FULL, key: value}
    with suppress(TruejointError):
        gear = schema.read(Gear, changed, "gear.toml")
        again = schema.read(Gear, schema.plain(gear), "gear.toml")
        assert repr(schema.plain(again)) == repr(schema.plain(gear))
