"""Compiled kernels: IEEE divisions, views that share memory, and calls through an address."""

from __future__ import annotations

import importlib
import sys
from collections import namedtuple
from enum import IntFlag
from types import FunctionType, ModuleType

import numpy as np
import pytest
from numba import njit, types
from numba.core.runtime import _nrt_python, rtsys
from numba.extending import intrinsic

from truejoint.compiled import (
    VECTOR,
    _content,
    _ingredients,
    _say_uncached,
    address,
    borrow,
    call_address,
    compiled,
    copy,
    fill,
    inlined,
    local_matrix,
    local_vector,
    matrix,
    unrolled,
    vector,
)

SIGNATURE = types.void(types.float64, VECTOR)


@compiled
def divide(a, b):
    return a / b


@inlined
def doubled(x):
    return 2.0 * x


@compiled
def halves(memory, offset, n):
    """Double a view of the memory, and give its sum as a matrix of two rows."""
    own = vector(memory, offset, 2 * n)
    for i in range(2 * n):
        own[i] = doubled(own[i])
    table = matrix(memory, offset, 2, n)
    total = 0.0
    for i in range(2):
        for j in range(n):
            total += (i + 1) * table[i, j]
    return total


def test_a_kernel_is_compiled_into_its_callers_and_for_python_when_python_calls_it():
    @compiled
    def tripled(x):
        return 3.0 * x

    @njit
    def caller(x):
        return tripled(x) + doubled(x)

    assert caller(2.0) == 10.0
    assert tripled.part.signatures
    assert not tripled.signatures
    assert tripled(2.0) == 6.0
    assert tripled.signatures


@intrinsic
def call_at(_typing, place, value, out):
    return types.void(types.int64, *SIGNATURE.args), call_address


@compiled
def call_twice(place, value, out):
    call_at(place, value, out)
    call_at(place, value, out)


@njit
def add(value, out):
    out[0] += value


@njit
def subtract(value, out):
    out[0] -= value


@compiled
def first_of(x):
    return borrow(x)[0]


def test_a_division_by_zero_is_infinite_or_nan():
    assert divide(1.0, 0.0) == np.inf
    assert divide(-1.0, 0.0) == -np.inf
    assert np.isnan(divide(0.0, 0.0))


def test_views_share_the_memory():
    memory = np.arange(10.0)
    assert halves(memory, 2, 3) == 2.0 * ((2 + 3 + 4) + 2 * (5 + 6 + 7))
    assert memory.tolist() == [0, 1, 4, 6, 8, 10, 12, 14, 8, 9]


@compiled
def outer_trace(x, rounds):
    """Sum over some rounds of the trace of x x', by way of two arrays of its own."""
    total = 0.0
    for _ in range(rounds):
        own, table = local_vector(3), local_matrix(3, 2)
        for i in range(3):
            own[i] = x[i]
            table[i, 0], table[i, 1] = own[i], own[i] * own[i]
        for i in range(3):
            total += table[i, 1] + 0.0 * table[i, 0]
    return total


def test_what_is_local_asks_nothing_of_the_heap():
    x = np.array([1.0, 2.0, 3.0])
    assert outer_trace(x, 2) == 28.0
    _nrt_python.memsys_enable_stats()
    try:
        taken = []
        for rounds in (1, 100_000):  # a stack that grew with them would be gone
            counts = []
            for _ in range(5):  # the least of five: other threads of the process allocate too
                before = rtsys.get_allocation_stats().alloc
                assert outer_trace(x, rounds) == 14.0 * rounds
                counts.append(rtsys.get_allocation_stats().alloc - before)
            taken.append(min(counts))
    finally:
        _nrt_python.memsys_disable_stats()
    assert taken[0] == taken[1]


def test_one_kernel_calls_any_function_of_its_signature():
    out = np.zeros(1)
    call_twice(address(add, SIGNATURE), 1.5, out)
    assert out[0] == 3.0
    call_twice(address(subtract, SIGNATURE), 0.5, out)
    assert out[0] == 2.0
    assert address(add, SIGNATURE) == address(add, SIGNATURE) != address(subtract, SIGNATURE)


def test_a_borrowed_array_is_the_array():
    x = np.array([3.0, 4.0])
    assert first_of(x) == 3.0


def test_small_loops():
    source, target = np.arange(5.0), np.zeros(5)
    copy(source, target, 3)
    assert target.tolist() == [0, 1, 2, 0, 0]
    fill(target, 2, 7.0)
    assert target.tolist() == [7, 7, 2, 0, 0]
    assert unrolled(4) == 4


def test_without_a_place_for_the_cache_it_is_compiled_all_the_same(monkeypatch, caplog):
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [])
    _say_uncached.cache_clear()
    try:
        tripled, negated = compiled(lambda x: 3 * x), inlined(lambda x: -x)
    finally:
        _say_uncached.cache_clear()
    assert (tripled(2.0), negated(2.0)) == (6.0, -2.0)
    assert ["set NUMBA_CACHE_DIR" in record.message for record in caplog.records] == [True]


CALLEE = """
from truejoint.compiled import inlined
GAIN = {gain}

@inlined
def scaled(x):
    return {factor} * x
"""
CALLER = """
import edited_callee as other
from truejoint.compiled import compiled

@compiled
def total(x):
    return later(x) + other.GAIN

@compiled
def later(x):
    return other.scaled(x)
"""


def total_after_edit(folder, monkeypatch, gain, factor):
    """Kernel of one module as a new process would have it once another module is edited."""
    (folder / "edited_callee.py").write_text(CALLEE.format(gain=gain, factor=factor))
    for name in ("edited_caller", "edited_callee"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    _content.cache_clear()
    return importlib.import_module("edited_caller").total


def test_what_is_kept_of_a_kernel_is_made_anew_after_an_edit_of_what_it_takes(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # which tells edits by the second
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "edited_caller.py").write_text(CALLER)
    for gain, factor, kept in [(1.0, 2.0, 0), (1.0, 2.0, 1), (5.0, 2.0, 0), (5.0, 4.0, 0)]:
        total = total_after_edit(tmp_path, monkeypatch, gain, factor)
        assert total(3.0) == 3.0 * factor + gain
        assert sum(total.stats.cache_hits.values()) == kept


def test_what_is_kept_of_a_kernel_whose_type_was_renamed_is_made_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("First", "Second"):
        (tmp_path / "renamed_type.py").write_text(
            f"import typing\nclass {name}(typing.NamedTuple):\n    x: float\nPair = {name}\n"
        )
        (tmp_path / "of_renamed_type.py").write_text(
            "from renamed_type import Pair\nfrom truejoint.compiled import compiled\n"
            "@compiled\ndef next_of(pair: Pair):\n    return pair.x + 1.0\n"
        )
        for module in ("renamed_type", "of_renamed_type"):
            monkeypatch.delitem(sys.modules, module, raising=False)
        _content.cache_clear()
        kernel = importlib.import_module("of_renamed_type")
        assert kernel.next_of(kernel.Pair(2.0)) == 3.0


def made_of(**changed):
    """What goes into a kernel that takes a bit of everything, of which some is changed."""
    fields = ModuleType("fields")
    fields.PLACE = changed.pop("PLACE", 3)

    def kernel(x: Pair):  # noqa: F821
        return LEVEL * TABLE[0] + NAMES[1][0] + fields.PLACE  # noqa: F821

    given = {
        "LEVEL": 1.0, "TABLE": np.zeros(2), "NAMES": (1, (2, 3)), "OTHER": 1,
        "Pair": namedtuple("Pair", "a b"), **changed,
    }  # fmt: skip
    moved = FunctionType(kernel.__code__, given, closure=kernel.__closure__)
    moved.__annotations__ = kernel.__annotations__
    return _ingredients(moved)


@pytest.mark.parametrize(
    "changed",
    [{"LEVEL": 1}, {"LEVEL": 1.5}, {"TABLE": np.ones(2)}, {"TABLE": np.zeros((1, 2))},
     {"NAMES": (1, (2, 4))}, {"PLACE": 4}, {"Pair": namedtuple("Pair", "b a")},
     {"LEVEL": doubled}],
)  # fmt: skip
def test_each_thing_that_a_kernel_takes_is_one_that_it_is_made_of(changed):
    assert made_of(**changed) != made_of()


def test_the_members_of_an_enumeration_are_what_a_kernel_is_made_of():
    one, other = (made_of(Pair=IntFlag("Pair", names)) for names in ("a b", "b a"))
    assert one != other


def test_what_a_kernel_does_not_take_is_none_that_it_is_made_of():
    assert made_of(OTHER=2) == made_of()
