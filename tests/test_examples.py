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

import truejoint
from truejoint import Recording
from truejoint.recordings import Provenance

PACKAGES = (
    "truejoint",
    "truejoint.calibration",
    "truejoint.crtk",
    "truejoint.errors",
    "truejoint.estimators",
    "truejoint.evaluation",
    "truejoint.export",
    "truejoint.filters",
    "truejoint.features",
    "truejoint.monitor",
    "truejoint.motion",
    "truejoint.recordings",
    "truejoint.recordings.datasets",
    "truejoint.robots",
    "truejoint.runtime",
    "truejoint.simulation",
    "truejoint.studies",
    "truejoint.tip",
)


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


def _motion(seed: int) -> Recording:
    """Four seconds of a jaw whose cable stretches with its effort."""
    random = np.random.default_rng(seed)
    t = np.arange(400) / 100
    jaw = 0.5 + 0.3 * np.sin(2 * t + random.uniform(0, 6)) * np.sin(5 * t)
    effort = 0.02 * np.cos(3 * t + random.uniform(0, 6)) + 1e-3 * random.standard_normal(400)
    truth = 1.02 * jaw + 0.5 * effort + 0.01 + 1e-4 * random.standard_normal(400)
    columns = {"t": t, "measured/jaw": jaw, "effort/jaw": effort, "truth/jaw": truth}
    about = Provenance("davinci_grasper", source=f"motion_{seed}.csv", session=str(seed))
    return Recording.from_columns(columns, about)


@pytest.fixture(scope="session")
def variables() -> dict[str, Any]:
    """What the examples may use: recordings, a calibration and how good it is, an arm, a filter."""
    training = [_motion(seed) for seed in range(2)]
    model = truejoint.calibrate(training, "linear")
    unseen = [_motion(seed) for seed in range(10, 19)]
    model = truejoint.calibration.with_interval(model, unseen)
    test = _motion(9)
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
