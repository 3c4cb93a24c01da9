"""What a prototype needs: plain functions, and the textbook to compare with."""

import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from truejoint.filters import FilterStatus, StateSpaceModel, UnscentedFilter

DT = 0.01
PRIOR = {"x0": [0.3, 0.0], "P0": np.diag([1e-2, 1e-2])}
NOISE = np.diag([1e-8, 1e-6])


def swing(x, u, dt, parameters, out):
    out[0] = x[0] + dt * x[1]
    out[1] = x[1] - dt * parameters[0] * math.sin(x[0])


def encoder(x, u, parameters, out):
    out[0] = x[0]


def pendulum(compiled=njit, **changes):
    given = {
        "transition": compiled(swing), "measurement": compiled(encoder), "process_noise": NOISE,
        "measurement_noise": [[1e-4]], "states": ("angle", "rate"), "measurements": ("encoder",),
        "parameters": (9.81,),
    }  # fmt: skip
    return StateSpaceModel(**(given | changes))


@pytest.fixture(scope="module")
def unscented():
    return UnscentedFilter(pendulum())


@pytest.fixture(scope="module")
def z():
    rng, x, rows = np.random.default_rng(3), np.array([0.4, 0.0]), []
    for _ in range(300):
        x = x + DT * np.array([x[1], -9.81 * math.sin(x[0])])
        rows.append(x[0] + rng.normal(0.0, 1e-2))
    return np.array(rows)[:, None]


def test_plain_functions_give_the_bits_of_compiled_ones_and_say_what_they_cost(unscented, z):
    with pytest.warns(RuntimeWarning, match="swing is plain Python, which numba compiles") as told:
        plain = UnscentedFilter(pendulum(lambda function: function))
    assert len(told) == 2
    assert Path(told[0].filename) == Path(__file__)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = plain.run(z, dt=DT, **PRIOR)
    np.testing.assert_array_equal(found.x, unscented.run(z, dt=DT, **PRIOR).x)


@pytest.mark.filterwarnings("ignore:.*plain Python")
def test_a_plain_function_that_raises_counts_as_failed(z, capfd):
    def fails(x, u, parameters, out):
        if x[0] < 0.1:
            raise ValueError("out of sight")
        out[0] = x[0]

    model = pendulum(measurement=fails)
    status = UnscentedFilter(model).run(z[:60], dt=DT, **PRIOR).status
    assert status[0] == 0
    assert status[-1] & FilterStatus.MEASUREMENT_FAILED
    assert "out of sight" not in "".join(capfd.readouterr())


def test_the_textbook_of_the_docs_gives_the_kernels_numbers(unscented, z):
    page = (Path(__file__).parents[2] / "docs" / "estimators.md").read_text("utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (code,) = (block for block in blocks if "def textbook" in block)
    names: dict = {}
    exec(code, names)  # noqa: S102 - our own page

    def f(x):
        return np.array([x[0] + DT * x[1], x[1] - DT * 9.81 * math.sin(x[0])])

    states = names["textbook"](
        f, lambda x: x[:1], NOISE, np.array([[1e-4]]), z, np.array(PRIOR["x0"]), PRIOR["P0"]
    )
    np.testing.assert_allclose(unscented.run(z, dt=DT, **PRIOR).x, states, rtol=1e-9, atol=1e-12)
