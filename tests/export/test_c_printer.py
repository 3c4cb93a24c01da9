"""Small kernels, printed, compiled, and held to what numba makes of them, bit for bit."""

import ctypes
import math
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, copy, matrix, vector
from truejoint.export.c_printer import print_kernels
from truejoint.export.c_values import Unprintable
from truejoint.layout import Layout, Memory

from .library import FLAGS, SAME_BITS, compile_c, needs_compiler

LAYOUT = Layout()
COUNT = LAYOUT.add("count", "integer", "calls so far")
MODE = LAYOUT.add("mode", "integer", "which way")
GAIN = LAYOUT.add("gain", "scalar", "of the sum")
X = LAYOUT.add("x", "array", "input")
W = LAYOUT.add("w", "array", "weights (3, 3)")
OUT = LAYOUT.add("out", "array", "output")


@compiled
def weigh(x: Array, w: Array, out: Array) -> None:
    """Weigh a vector by the rows of a matrix."""
    for i in range(w.shape[0]):
        row = w[i]
        total = 0.0
        for j in range(w.shape[1]):
            total += row[j] * x[j]
        out[i] = total


@compiled
def products(numbers: Integers, memory: Array) -> None:
    """Weigh, and scale."""
    x, out = vector(memory, numbers[X], 3), vector(memory, numbers[OUT], 3)
    weigh(x, matrix(memory, numbers[W], 3, 3), out)
    for i in range(3):
        out[i] = (out[i] - x[i]) - (x[0] - out[i] / memory[GAIN]) * memory[GAIN]


@compiled
def choices(numbers: Integers, memory: Array) -> None:
    """Choose by what is known, and by what is not."""
    x, out = vector(memory, numbers[X], 3), vector(memory, numbers[OUT], 3)
    best = -1
    for i in range(3):
        if not (x[i] <= 1.0):
            continue
        if best < 0 or x[i] > x[best]:
            best = i
    value = x[best] if best >= 0 else math.nan
    if numbers[MODE] == 1:
        value = -value
    elif value > 0.5 and not (x[0] == x[1] or x[1] != x[2]):
        value = 0.5
    out[0] = min(max(value, x[0], -2.0), x[2])
    out[1] = float(best)
    out[2] = np.sign(value) * abs(x[1]) ** 2


@compiled
def history(numbers: Integers, memory: Array) -> None:
    """Remember how often it was called, and what came last."""
    numbers[COUNT] += 1
    x, out = vector(memory, numbers[X], 3), vector(memory, numbers[OUT], 3)
    if numbers[COUNT] % 3 == 0:
        copy(x, out, 3)
        return
    for i in range(2, -1, -1):
        out[i] = out[i] * 0.5 + math.exp(-abs(x[i])) / numbers[COUNT]


@compiled
def move(x: Array, out: Array) -> None:
    """Move two numbers."""
    for i in range(2):
        out[i] = x[i]


@compiled
def overlaps(numbers: Integers, memory: Array) -> None:
    """Move numbers on by one place."""
    x = vector(memory, numbers[X], 3)
    move(x[0:2], x[1:3])


@compiled
def comprehends(numbers: Integers, memory: Array) -> None:
    """Use what no C is printed for."""
    memory[GAIN] = sum([memory[GAIN], 1.0])


def packed(mode: int = 0) -> Memory:
    weights = np.random.default_rng(1).normal(size=(3, 3))
    return LAYOUT.pack(mode=mode, gain=0.7, x=np.zeros(3), w=weights, out=np.zeros(3))


def printed(kernel, mode: int = 0, *, single: bool = False):
    return print_kernels(
        [kernel], packed(mode), "state", "m_state", inputs=("x", "out"), single=single
    )


@cache
def library(kernel, mode: int) -> ctypes.CDLL:
    program = printed(kernel, mode)
    folder = Path(mkdtemp())
    text = f"""#include <math.h>
{program.structs}
{program.constants}
{program.functions}
void run(const double *x, double *out, int n);
void run(const double *x, double *out, int n)
{{
    static const m_state initial = {program.initial};
    m_state state = initial;
    for (int i = 0; i < n; i++) {{
        for (int j = 0; j < 3; j++) {{
            state.x[j] = x[3 * i + j];
        }}
        {program.names[0]}(&state);
        for (int j = 0; j < 3; j++) {{
            out[3 * i + j] = state.out[j];
        }}
    }}
}}
"""
    (folder / "m.c").write_text(text, encoding="ascii")
    compile_c([folder / "m.c"], folder / "m.so", *FLAGS, *SAME_BITS)
    return ctypes.CDLL(str(folder / "m.so"))


NUMBERS = st.floats() | st.sampled_from([0.0, -0.0, 0.5, 1.0, -1.0])


@needs_compiler
@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("kernel", [products, choices, history], ids=lambda k: k.__name__)
@settings(max_examples=30, deadline=None)
@given(rows=st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=1, max_size=5))
def test_c_gives_the_same_bits(kernel, mode, rows):
    x, memory = np.array(rows), packed(mode)
    wanted, got = np.empty_like(x), np.empty_like(x)
    for i, row in enumerate(x):
        memory.view("x")[:] = row
        kernel(memory.numbers, memory.memory)
        wanted[i] = memory.view("out")
    pointers = (a.ctypes.data_as(ctypes.c_void_p) for a in (x, got))
    library(kernel, mode).run(*pointers, len(x))
    np.testing.assert_array_equal(got, wanted)
    np.testing.assert_array_equal(np.signbit(got[got == 0]), np.signbit(wanted[got == 0]))


def test_what_is_known_is_folded_in():
    known, other = (printed(choices, mode).functions for mode in (1, 0))
    assert "mode" not in known + other
    assert "value = -value;" in known
    assert "value = -value;" not in other
    assert "static const double m_w[9]" in printed(products).constants  # weigh has a w
    assert "int count; /* calls so far */" in printed(history).structs
    assert "gain" not in printed(products).structs


def test_pointers_are_restricted_where_no_call_lets_them_overlap():
    assert "double *restrict out" in printed(products).functions
    assert "restrict" not in printed(overlaps).functions


def test_single_precision_has_float_constants():
    program = printed(products, single=True)
    assert "double" not in program.functions
    assert "static const float m_gain = 0.7f;" in program.constants


def test_what_has_no_c_is_refused_in_one_line():
    with pytest.raises(Unprintable, match="comprehends, line") as caught:
        printed(comprehends)
    assert "\n" not in str(caught.value)
