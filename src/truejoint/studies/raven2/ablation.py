"""What each group of the state's features is worth: left out, and with noise on it.

As in H. Peng, A. Lewis, B. Hannaford, "Ablation study on features in learning-based joints
calibration of cable-driven surgical robots", arXiv 2302.04999, on which peng2024, II-C, rests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from truejoint.evaluation.metrics import rmse
from truejoint.recordings import Recording
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.features import all_features, with_state
from truejoint.studies.study import Part, PartResult, Settings, Summary, check_counts
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
    check_counts(settings, "minutes", "sessions", "noise")
    s.combination(settings["training"])
    common = {
        "training": settings["training"],
        "seconds": 60.0 * settings["minutes"],
        "noise": settings["noise"],
    }
    return s.part_for_each(settings, leave_out, _OFFSET, common)


def leave_out(raven: s.Plain, seed: int, training: str, seconds: float, noise: float) -> PartResult:
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
    found = {name: s.judged(models, test) for name, models in fitted.items()}
    for group, quantities in GROUPS.items():
        spoilt = _with_noise(test, quantities, noise, seed)
        found[f"all, noise on {group}"] = _judged(fitted["all"], test, spoilt)
    for group in ("positions", "torques"):
        spoilt = _with_noise(test, GROUPS[group], noise, seed)
        found[f"selected, noise on {group}"] = _judged(fitted["16 selected"], test, spoilt)
    return PartResult({"errors": found})


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


def _judged(models: s.Models, test: Recording, spoilt: Recording) -> s.Errors:
    """RMSE where the errors are predicted from spoilt features; measured positions are not."""
    error = test.error(s.JOINTS)
    known = np.isfinite(error).all(axis=1)
    return {
        method: [rmse((model.predict_error(spoilt) - error)[known]).tolist() for model in ones]
        for method, ones in models.items()
    }


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """RMSE by what is left out or spoilt, and what is said of the groups."""
    made, figures, judged = [], {}, []
    for title, numbers in s.numbers_of(settings, results).items():
        found = {name: [one["errors"][name] for one in numbers] for name in numbers[0]["errors"]}
        name = f"Groups of features, specimen {title}"
        notes = (
            "; ".join(f"{group}: {', '.join(own)}" for group, own in GROUPS.items()) + ".",
            f"Noise: {settings['noise']:g} of the standard deviation of each feature.",
            RULE,
        )
        made.append(tables.accuracy_table(name, found, _METHODS, tables.unprinted, notes))
        figures[f"ablation-{title}"] = tables.accuracy_figure(
            name, found, _METHODS, tables.unprinted, "RMSE by what is left out or spoilt."
        )
        judged += [claim.judged(found, title) for claim in CLAIMS]
    return Summary(made, figures, judged)


def _of(name: str, joint: int) -> claims.Pick:
    return lambda found: tables.by_session(found[name], "dnn")[:, joint]


def _matters(joint: int, more: str, less: str) -> claims.Pair:
    """Pair that says that one group is missed more than another of the 16."""
    return (
        f"{s.JOINTS[joint]}, without {less} and without {more}",
        _of(f"selected without {less}", joint),
        _of(f"selected without {more}", joint),
    )


CLAIMS: Final = (
    claims.kept(
        "joint positions and motor torques are enough: the network loses nothing without the rest",
        "peng2024, II-C",
        0.05,
        *((joint, _of("all", k), _of("16 selected", k)) for k, joint in enumerate(s.JOINTS)),
    ),
    claims.ordered(
        "joint 3 is the one in which torques matter more than positions",
        "peng2024, III",
        _matters(0, "positions", "torques"),
        _matters(1, "positions", "torques"),
        _matters(2, "torques", "positions"),
    ),
)
