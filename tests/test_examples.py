"""Every public name says what it is and shows it: the examples of the docstrings, run."""

import doctest
import inspect
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.conftest import LaggingBackend
from tests.filters.linear import linear_model
from tests.synthetic import jaw_motion

import truejoint

SOURCE = Path(truejoint.__file__).parent
PACKAGES = (
    "truejoint.errors",
    "truejoint.simulation",
    *(".".join(stub.parent.relative_to(SOURCE.parent).parts)
      for stub in sorted(SOURCE.rglob("__init__.pyi"))),
)  # fmt: skip


@cache
def _public(package: str) -> dict[str, Any]:
    """Functions and classes of a package; a protocol is shown by what satisfies it."""
    module = import_module(package)
    defined = [n for n, v in vars(module).items() if getattr(v, "__module__", "") == package]
    own = [name for name in defined if not name.startswith("_")]
    values = {name: getattr(module, name) for name in getattr(module, "__all__", own)}
    return {
        name: value
        for name, value in values.items()
        if (inspect.isclass(value) and not getattr(value, "_is_protocol", False))
        or inspect.isroutine(value)
        or hasattr(value, "__wrapped__")
    }


NAMES = [(package, name) for package in PACKAGES for name in _public(package)]


@pytest.fixture(scope="session")
def variables() -> dict[str, Any]:
    """What the examples may use: recordings, a calibration and how good it is, an arm, a filter."""
    training = [jaw_motion(seed) for seed in range(2)]
    model = truejoint.calibrate(training, "linear")
    unseen = [jaw_motion(seed) for seed in range(10, 19)]
    model = truejoint.calibration.with_interval(model, unseen)
    test = jaw_motion(9)
    arm = truejoint.crtk.Arm(LaggingBackend(0.02))
    arm.enable()
    arm.home()
    return {
        "truejoint": truejoint,
        "np": np,
        "pd": pd,
        "arm": arm,
        "training": training,
        "model": model,
        "test": test,
        "evaluation": truejoint.evaluate(model, test),
        "random_walk": linear_model([[1.0]], [[]], [[1.0]], [[0.1]], [[1.0]]),
    }


@pytest.mark.parametrize(("package", "name"), NAMES)
def test_a_public_name_has_an_example_that_runs(
    package: str,
    name: str,
    variables: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    value = _public(package)[name]
    assert inspect.getdoc(value), f"{package}.{name} says nothing of itself"
    names = {key: getattr(truejoint, key) for key in truejoint.__all__}
    names |= _public(package) | inspect.getmodule(value).__dict__ | variables
    tests = doctest.DocTestFinder().find(value, name, module=False, globs=names)
    own = doctest.DocTestParser().get_examples(inspect.getdoc(value) or "")
    assert own, f"{package}.{name} has no example"
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(
        optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE, verbose=False
    )
    said: list[str] = []
    for test in tests:
        runner.run(test, out=said.append, clear_globs=False)
    assert not runner.failures, "".join(said)
