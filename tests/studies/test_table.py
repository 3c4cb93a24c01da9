from __future__ import annotations

from truejoint.estimators.registry import estimator_names
from truejoint.studies.table import _rows, reported

PRINTED = {
    ("2", "trajectory 28", "lsm"): (1.45, -1.08, 0.57),
    ("2", "trajectory 28", "lsm_compensated"): (0.84, -0.79, 0.26),
    ("2", "trajectory 28", "ukf_compensated"): (0.39, -0.44, 0.12),
    ("figure 6", "trajectory 27", "ukf_compensated"): (0.27, -0.20, 0.06),
}
"""Largest, smallest and RMS error in degrees, of every method."""
TABLE_3 = {
    "30": (0.25, -0.23, 0.07, 0.15, 0.05),
    "50": (0.31, -0.24, 0.09, 0.07, 0.05),
    "100": (0.21, -0.25, 0.13, 0.05, 0.38),
    "200": (0.37, -0.24, 0.15, 0.06, 0.40),
    "250": (0.33, -0.22, 0.12, 0.05, 0.29),
}
"""By weight [g]: phase I, largest, smallest and RMS; RMS in phases II and IV."""


def test_every_number_is_the_papers():
    found = {key[1:]: dict(metrics) for key, metrics in _rows().items()}
    ends = ("max", "min", "rms")
    wanted = {key: dict(zip(ends, values, strict=True)) for key, values in PRINTED.items()}
    for grams, values in TABLE_3.items():
        for phase, own in (("I", values[:3]), ("II", values[3:4]), ("IV", values[4:])):
            names = ends if phase == "I" else ("rms",)
            key = ("3", f"load={grams}g phase {phase}", "ukf_compensated")
            wanted[key] = dict(zip(names, own, strict=True))
    assert found == wanted


def test_what_is_not_printed_is_empty():
    assert reported("yan2020", "2", "trajectory 28", "play_gated") == {}


def test_methods_are_named_as_our_estimators():
    assert {method for _, _, _, method in _rows()} <= set(estimator_names())
