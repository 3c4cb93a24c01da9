"""Named fields of flat arrays: what is declared is where kernels find it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from truejoint.compiled import compiled, vector
from truejoint.layout import Layout, part_memory, part_numbers

INNER = Layout()
SIZE = INNER.add("size", "integer", "of the weights")
BIAS = INNER.add("bias", "scalar", "added")
WEIGHTS = INNER.add("weights", "array", "of the inputs")

OUTER = Layout()
FIRST = OUTER.add("first", "part", "before")
COUNT = OUTER.add("count", "integer", "rows")
OUTER.add("table", "array", "two columns", "count", 2)
OUTER.add("order", "integers", "of the rows", "count")
STAMP = OUTER.add("stamp", "scalar", "of the last row [s]", is_time=True)
LAST = OUTER.add("last", "part", "behind")
unpack = OUTER.unpacker()


def inner(bias: float, *weights: float):
    return INNER.pack(size=len(weights), bias=bias, weights=weights)


def outer():
    return OUTER.pack(
        first=inner(1.0, 10.0, 20.0), last=inner(-1.0, 0.5), order=[1, 0],
        table=[[1.0, 2.0], [3.0, 4.0]], stamp=7.0,
    )  # fmt: skip


@compiled
def weigh(numbers, memory, value):
    """Bias and sum of the weights, which become `value`."""
    weights = vector(memory, numbers[WEIGHTS], numbers[SIZE])
    total = memory[BIAS]
    for i in range(weights.shape[0]):
        total += weights[i]
        weights[i] = value
    return total


@compiled
def weigh_all(numbers, memory, value):
    """The table by its order, and both parts."""
    m = unpack(numbers, memory)
    first = weigh(part_numbers(numbers, FIRST), part_memory(numbers, memory, FIRST), value)
    last = weigh(part_numbers(numbers, LAST), part_memory(numbers, memory, LAST), value)
    memory[STAMP] += 1.0
    second = m.table[m.order[1], m.table.shape[1] - 1]
    return m.table[m.order[0], 0], second, first, last, m.stamp


def test_kernels_find_every_field():
    packed = outer()
    assert weigh_all(packed.numbers, packed.memory, 0.25) == (3.0, 2.0, 31.0, -0.5, 7.0)
    assert weigh_all(packed.numbers, packed.memory, 0.25) == (3.0, 2.0, 1.5, -0.75, 8.0)
    assert packed.memory[STAMP] == 9.0


def test_a_view_shares_the_memory_and_a_copy_does_not():
    packed = outer()
    view, copy = packed.view("table"), packed.copy()
    view[1, 1] = 40.0
    assert packed.view("table").tolist() == [[1.0, 2.0], [3.0, 40.0]]
    assert copy.view("table").tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert copy.view("order").tolist() == [1, 0]
    assert copy.view("order").dtype == np.int64


def test_a_part_is_copied_into_the_whole():
    part = inner(1.0, 10.0, 20.0)
    packed = OUTER.pack(first=part, last=part, table=np.zeros((0, 2)), order=[])
    weigh(part_numbers(packed.numbers, FIRST),
          part_memory(packed.numbers, packed.memory, FIRST), 0.0)  # fmt: skip
    assert part.view("weights").tolist() == [10.0, 20.0]
    assert packed.parts["last"] is part
    assert packed.view("table").shape == (0, 2)


def test_a_part_of_a_part_shares_the_memory_of_the_whole():
    middle, whole = Layout(), Layout()
    middle.add("inner", "part", "within")
    whole.add("before", "integer", "it")
    whole.add("middle", "part", "within")
    own = middle.pack(inner=inner(1.0, 10.0, 20.0))
    packed = whole.pack(before=3, middle=own)
    found = packed.part("middle", "inner")
    assert found.layout is own.parts["inner"].layout
    for name in ("numbers", "memory"):
        np.testing.assert_array_equal(getattr(found, name), getattr(own.parts["inner"], name))
        assert np.shares_memory(getattr(found, name), getattr(packed, name))


def test_what_is_not_given_is_zero():
    packed = INNER.pack(weights=[1.0])
    assert (packed.numbers[SIZE], packed.memory[BIAS]) == (0, 0.0)
    part = inner(1.0)
    packed = OUTER.pack(first=part, last=part, order=[1, 0])
    np.testing.assert_array_equal(packed.view("table"), np.zeros((2, 2)))
    packed = OUTER.pack(first=part, last=part, count=1)
    assert packed.view("order").tolist() == [0]
    with pytest.raises(ValueError, match=r"fields \['order', 'table'\] are missing"):
        OUTER.pack(first=part, last=part)


@pytest.mark.parametrize("name", ["size", "bias", "", "two words", "1st"])
def test_a_name_that_is_none_or_stands_twice_is_refused(name):
    layout = Layout()
    layout.add("size", "integer", "")
    layout.add("bias", "scalar", "")
    with pytest.raises(ValueError, match="is no name, or stands twice"):
        layout.add(name, "array", "")


KINDS = ("integer", "scalar", "array", "integers", "part")


@given(st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 4)), max_size=12), st.randoms())
def test_whatever_the_order_every_value_is_found_again(declared, random):
    layout, values, index = Layout(), {}, {}
    for i, (kind, size) in enumerate(declared):
        name = f"field_{i}"
        index[name] = layout.add(name, kind, "")
        values[name] = {
            "integer": i,
            "scalar": i + 0.5,
            "array": np.arange(size) + i,
            "integers": np.arange(2 * size).reshape(2, size) - i,
            "part": inner(float(i), *range(size)),
        }[kind]
    names = list(values)
    random.shuffle(names)
    packed = layout.pack(**{name: values[name] for name in names})
    for i, (kind, _size) in enumerate(declared):
        name = f"field_{i}"
        if kind in ("integer", "scalar"):
            assert (packed.numbers if kind == "integer" else packed.memory)[index[name]] == (
                values[name]
            )
        elif kind == "part":
            start, memory_start, count, size = packed.numbers[index[name] : index[name] + 4]
            np.testing.assert_array_equal(
                packed.numbers[start : start + count], values[name].numbers
            )
            np.testing.assert_array_equal(
                packed.memory[memory_start : memory_start + size], values[name].memory
            )
        else:
            np.testing.assert_array_equal(packed.view(name), values[name])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"order": [1], "table": [[1.0, 2.0]], "more": 1}, r"\['more'\] are missing or unknown"),
        ({"order": [1], "table": [[1.0, 2.0], [3.0, 4.0]]}, r"\(2, 2\); it must be \(1, 2\)"),
        ({"order": [1], "table": [[1.0, 2.0, 3.0]]}, r"'table' has shape \(1, 3\); it must"),
        ({"order": [[1]], "table": [[1.0, 2.0]]}, "'order' has shape"),
    ],
)
def test_values_that_do_not_fit_their_declaration_or_each_other_are_refused(values, said):
    layout = Layout()
    layout.add("order", "integers", "of the rows", "count")
    layout.add("table", "array", "two columns", "count", 2)
    with pytest.raises(ValueError, match=said):
        layout.pack(**values)
