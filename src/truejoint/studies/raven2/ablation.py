"""What each group of the state's features is worth: left out, and with noise on it.

As in H. Peng, A. Lewis, B. Hannaford, "Ablation study on features in learning-based joints
calibration of cable-driven surgical robots", arXiv 2302.04999, on which peng2024, II-C, rests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.recordings import Recording
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.features import all_features, with_state
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.studies.verdicts import RULE

GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "positions": ("measured", "motor", "encoder", "encoder_offset", "tool", "rotation"),
    "torques": ("effort", "dac"),
    "velocities": ("velocity", "motor_velocity", "jacobian_velocity", "jacobian_force"),
    "set-points": (
        "setpoint", "motor_setpoint", "tool_setpoint", "rotation_setpoint", "grasp_setpoint",
    ),
    "status": ("state", "arm"),
}  # fmt: skip
"""Quantities of the state message that follow from each other, so that one replaces another."""
_OFFSET: Final = 800_000  # of the arms' seeds, so that no other study has the same
_METHODS: Final = ("dnn", "linear")
_FIT_RATE: Final = 10.0  # [Hz]: many fits, of features that do not need more
_CHOSEN: Final = ("measured", "effort")


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    settings.check_positive("minutes", "sessions", "noise")
    s.combination(settings["training"])
    common = {
        "training": settings["training"],
        "seconds": 60.0 * settings["minutes"],
        "noise": settings["noise"],
    }
    return s.part_for_each(settings, leave_out, _OFFSET, common)


def leave_out(raven: s.Plain, seed: int, training: str, seconds: float, noise: float) -> Rows:
    """Fit without each group in turn, and judge; then judge the whole with noise on each.

    `noise` is the standard deviation as a share of that of the feature.
    """
    arm, twin = s.homed(raven, seed)
    own = [with_state(one, twin) for one in s.training_sets(arm, (training,))[training]]
    test = with_state(s.random_test(arm, seconds, s.TEST_SEED + seed), twin)
    every = all_features(test)
    chosen = [name for name in every if _quantity(name) in _CHOSEN]
    sets = {"all": every, "16 selected": chosen}
    for group, quantities in GROUPS.items():
        sets[f"all without {group}"] = [n for n in every if _quantity(n) not in quantities]
    for group in ("positions", "torques"):
        left = [n for n in chosen if _quantity(n) not in GROUPS[group]]
        sets[f"selected without {group}"] = left
    fitted = {
        name: s.fitted(own, 1, seed, features=features, fit_rate=_FIT_RATE)
        for name, features in sets.items()
    }
    rows: Rows = []
    for name, models in fitted.items():
        rows += s.judged(models, test, condition=name)
    for every, kind, groups in (
        ("all", "all", GROUPS), ("16 selected", "selected", ("positions", "torques"))
    ):  # fmt: skip
        for group in groups:
            spoilt = _with_noise(test, GROUPS[group], noise, seed)
            name = f"{kind}, noise on {group}"
            rows += _judged(fitted[every], test, spoilt, name)
    return rows


def _quantity(feature: str) -> str:
    return feature.partition("/")[0]


def _with_noise(test: Recording, quantities: Sequence[str], share: float, seed: int) -> Recording:
    """Add noise to the features of some quantities."""
    rng = np.random.default_rng(seed)
    changed = {}
    for name in test.units:
        if _quantity(name) in quantities:
            values = test.column(name)
            changed[name] = values + share * values.std() * rng.standard_normal(len(values))
    return replace(test, table=test.table.assign(**changed))


def _judged(models: s.Models, test: Recording, spoilt: Recording, condition: str) -> Rows:
    """RMSE where the errors are predicted from spoilt features; measured positions are not."""
    error = test.error(s.JOINTS)
    has_truth = np.isfinite(error).all(axis=1)
    rows: Rows = []
    for method, several in models.items():
        for n, model in enumerate(several):
            off = (model.predict_error(spoilt) - error)[has_truth]
            rows += s.rmse_rows(off, method, n, condition=condition)
    return rows


def summarise(results: Results) -> Summary:
    """RMSE by what is left out or spoilt, and what is said of the groups."""
    notes = (
        "; ".join(f"{group}: {', '.join(own)}" for group, own in GROUPS.items()) + ".",
        f"Noise: {results.settings['noise']:g} of the standard deviation of each feature.",
        RULE,
    )

    def of_specimen(title: str, rows: DataFrame) -> Summary:
        name, caption = (
            f"Groups of features, specimen {title}",
            "RMSE by what is left out or spoilt.",
        )
        table = tables.accuracy_table(name, rows, _METHODS, notes=notes)
        figure = tables.accuracy_figure(name, rows, _METHODS, caption)
        judged = [claim.judged(rows, title) for claim in CLAIMS]
        return Summary((table,), {f"ablation-{title}": figure}, judged)

    return tables.by_specimen(results, of_specimen)


def _without(*groups: str) -> claims.Pick:
    """Errors of the network without a group, in each of the joints."""

    def pick(rows: DataFrame, joint: str) -> Array:
        name = f"selected without {groups[s.JOINTS.index(joint)]}"
        return tables.by_session(rows, condition=name, method="dnn", joint=joint)

    return pick


CLAIMS: Final = (
    claims.not_worse(
        0.05,
        "joint positions and motor torques are enough: the network loses nothing without the rest",
        "peng2024, II-C",
        {"condition": "all"}, {"condition": "16 selected"}, method=("dnn",), joint=s.JOINTS,
    ),
    claims.ordered(
        "joint 3 is the one in which torques matter more than positions", "peng2024, III",
        _without("torques", "torques", "positions"), _without("positions", "positions", "torques"),
        joint=s.JOINTS,
    ),
)  # fmt: skip
