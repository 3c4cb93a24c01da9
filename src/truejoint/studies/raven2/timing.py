"""Table V of peng2024: what fitting and inferring take."""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.calibration import calibrate
from truejoint.errors import StudyError
from truejoint.estimators import estimator_names
from truejoint.runtime import Corrector
from truejoint.studies.claim_tests import below, below_all
from truejoint.studies.paper_tables import reported
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.claims import Verdict
from truejoint.studies.rows import frame_table
from truejoint.studies.study import Part, Results, Rows, Settings, Statement, Summary

SERVO: Final = 1e-3
"""Period of RAVEN-II's servo loop [s]."""
_COLD: Final = 300  # samples before times count
_BOUNDS: Final = {"dnn": 50.0, "linear": 2.0}  # [s], peng2024, Table V
_RATIO: Final = 160.0  # of the network's inference time to the linear model's (abstract)


def parts(settings: Settings) -> Sequence[Part]:
    """One: times of one machine are only comparable one after the other."""
    settings.check_names("model", "models", estimator_names())
    s.combination(settings["training"])
    if settings["samples"] < 1000:
        raise StudyError(f"samples={settings['samples']}; give 1000 or more")
    (raven,) = s.specimens(("peng2024",)).values()
    common = {name: settings[name] for name in ("models", "training", "samples", "repeats")}
    return (Part("timing", measure, {"raven": raven, "seed": settings.seed, **common}),)


def measure(
    raven: s.Plain,
    models: Sequence[str],
    seed: int,
    training: str,
    samples: int,
    repeats: int,
) -> Rows:
    """Time fits, and the control loop's corrections sample by sample [s]."""
    arm, _ = s.homed(raven, seed)
    sets = s.training_sets(arm, (training,))[training]
    test = s.random_test(arm, samples / s.STATE_RATE + 2.0, s.TEST_SEED + seed)
    calibrate([one.rows(slice(0, 400)) for one in sets], "linear")  # libraries and kernels
    few = test.rows(slice(0, 2))  # the shortest table, as a framework's call for a sample
    timed: Rows = []
    for _, name in product(range(repeats), models):
        # Processor time: what else the machine does shall not count.
        began = time.process_time()
        model = calibrate(sets, name)
        fit = time.process_time() - began
        corrector = Corrector(model)
        rows = test.table[list(corrector.signals)].to_numpy()[:samples]
        each = np.empty(len(rows))
        for i, (t, row) in enumerate(zip(test.t, rows, strict=False)):
            began = time.perf_counter()
            corrector.step(t, row)
            each[i] = time.perf_counter() - began
        whole = timeit.repeat(partial(model.correct, few), number=1, repeat=50)
        step, step_99 = np.quantile(each[_COLD:], [0.5, 0.99]).tolist()
        seconds = {"fit": fit, "table": float(np.median(whole)), "step": step, "step_99": step_99}
        timed.append({"method": name, **seconds, "rows": sum(map(len, sets))})
    return timed


def summarise(results: Results) -> Summary:
    """Table V beside the paper's."""
    rows = results.rows
    times = rows.groupby("method", sort=False).median(numeric_only=True)

    def printed(row: str, metric: str, form: str, scale: float = 1.0) -> list[str]:
        found = [
            reported("peng2024", "V", row, method, "all").get(metric) for method in times.index
        ]
        return ["" if value is None else form.format(scale * value) for value in found]

    table = DataFrame(
        {
            "fit [s of CPU]": times.fit,
            "paper": printed("training time", "upper bound", "< {:g}"),
            "a sample in the loop [us]": 1e6 * times.step,
            "99 %": 1e6 * times.step_99,
            "a call on a table [us]": (1e6 * times.table).map("{:.0f}".format),
            "paper [us]": printed("inference one sample", "mean", "{:g}", 1e3),
        }
    )
    notes = (
        f"{times.rows.iloc[0]:.0f} rows, sparsities {results.settings['training']}; medians, "
        "one thread, of the machine that ran this, with whatever else it did.",
        "The paper's are of a 2.2 GHz Xeon and a framework's call for each sample.",
    )
    judged = [c.judged(rows) for c in CLAIMS] if {"dnn", "linear"} <= set(times.index) else []
    title = "peng2024 Table V: time"
    return Summary((frame_table(title, table, notes, decimals=2, head="model"),), claims=judged)


def _of(rows: DataFrame, method: str, column: str) -> Array:
    """Give the times (k,) [s] of a model in every repetition."""
    return np.asarray(rows[rows.method == method][column])


def _fits(rows: DataFrame) -> Verdict:
    fits = {name: _of(rows, name, "fit") for name in _BOUNDS}
    texts = [f"{name} {np.median(seconds):.2f} s" for name, seconds in fits.items()]
    return below_all([(fits[name], most) for name, most in _BOUNDS.items()]), ", ".join(texts)


def _servo(name: str, *, expected: bool) -> Callable[[DataFrame], Verdict]:
    def judge(rows: DataFrame) -> Verdict:
        late = _of(rows, name, "step_99")
        text = f"{1e6 * np.median(late):.1f} us at 99 %"
        return below(late, SERVO) if expected else below(SERVO, late), text

    return judge


def _ratio(rows: DataFrame) -> Verdict:
    network, linear = (_of(rows, name, "step") for name in ("dnn", "linear"))
    text = (
        f"{np.median(network / linear):.1f} times; what took 61 ms there is a framework's overhead "
        f"a call, not the 12,103 weights, which take {1e6 * np.median(network):.1f} us compiled"
    )
    return below(_RATIO / 2.0, network / linear), text


CLAIMS: Final = (
    Statement("fitting takes < 50 s (network), < 2 s (linear)", "peng2024, Table V", _fits),
    Statement(
        "the linear model keeps up with the 1 kHz servo loop", "peng2024, III",
        _servo("linear", expected=True),
    ),
    Statement(
        "the network is too slow for the 1 kHz servo loop", "peng2024, III",
        _servo("dnn", expected=False), flaw=True,
    ),
    Statement(
        "the linear model infers about 160 times faster than the network", "peng2024, abstract",
        _ratio, flaw=True,
    ),
)  # fmt: skip
