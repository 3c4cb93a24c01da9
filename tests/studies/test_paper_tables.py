import pytest

from truejoint.estimators.registry import estimator_names
from truejoint.studies.rows import paper_numbers, reported

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
PERCENT = {
    "J1": ((25.0, 22.5, 25.0), (22.4, 28.1, 26.1), (36.8, 83.5, 49.2)),
    "J3": ((13.1, 16.5, 22.6), (20.8, 17.5, 25.4), (22.4, 28.3, 26.9)),
    "J2-J3": ((12.1, 13.7, 20.2), (10.9, 20.3, 17.0), (24.0, 35.1, 33.7)),
    "J1-J2-J3": ((16.5, 16.7, 25.5), (12.6, 14.2, 16.2), (34.9, 58.5, 35.8)),
}
"""Of peng2024, Table I, for each joint: network, polynomial, linear."""


def test_every_number_is_the_papers():
    found = {key[1:4]: dict(m) for key, m in paper_numbers().items() if key[0] == "yan2020"}
    ends = ("max", "min", "rms")
    wanted = {key: dict(zip(ends, values, strict=True)) for key, values in PRINTED.items()}
    for grams, values in TABLE_3.items():
        for phase, own in (("I", values[:3]), ("II", values[3:4]), ("IV", values[4:])):
            names = ends if phase == "I" else ("rms",)
            key = ("3", f"load={grams}g phase {phase}", "ukf_compensated")
            wanted[key] = dict(zip(names, own, strict=True))
    assert found == wanted


def test_shares_of_the_fixed_offset_are_those_that_peng2024_prints():
    for direction, printed in PERCENT.items():
        for joint, row in enumerate(printed, 1):
            rmse = {
                method: reported(
                    "peng2024", "I", f"direction={direction}", method, f"joint{joint}"
                )["rmse"]
                for method in ("dnn", "poly2", "linear", "offset")
            }
            shares = [100 * rmse[method] / rmse["offset"] for method in ("dnn", "poly2", "linear")]
            assert shares == pytest.approx(row, abs=0.15)  # of errors that are rounded themselves
    assert sum(key[0] == "peng2024" for key in paper_numbers()) == 173


def test_what_is_not_printed_is_empty():
    assert reported("yan2020", "2", "trajectory 28", "play_gated") == {}


def test_methods_are_named_as_our_estimators():
    others = {"raw", "rnn", "gpr", "ukf"}  # of the robot itself, and of other laboratories
    assert {key[3] for key in paper_numbers()} - others <= set(estimator_names())
