"""Methods on specimens of other frictions and sizes, unloaded and under weights, each a part."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, cast

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import Calibration
from truejoint.drawing import Curve, Figure, Panel
from truejoint.estimators.jaw.signals import RESET
from truejoint.recordings import Recording
from truejoint.runtime import Corrector
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.sensors import reference_error
from truejoint.simulation.forceps.specimens import population
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, record
from truejoint.studies.forceps.population import against_paper, quantile_texts
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text
from truejoint.tables import Table

LEVEL: Final = 0.9
"""Stated share of rows within the half-width."""
_HELD: Final = math.radians(0.15)
"""Error under a weight that counts as held [rad]."""
_BEFORE: Final = 0.5
"""Time before the hand comes that tells where the jaw stood without a weight [s]."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    m.check_methods(settings["methods"])
    common = {name: settings[name] for name in ("methods", "motion", "masses_g", "directions")}
    drawn = population(settings["count"], settings.seed, settings["prior"])
    for mass in settings["masses_g"]:
        for direction in settings["directions"]:
            load_test(mass, direction)  # refuses what cannot be
    return [
        Part(f"specimen-{n:05d}", judge, {"forceps": plant.to_dict(), "number": n, **common})
        for n, plant in enumerate(drawn)
    ]


def load_test(grams: float, direction: str) -> LoadTest:
    """Load test of IV-D at twice the paper's speed and with shorter waits; a weight in grams."""
    quick = {"start": 1.0, "loaded_from": 10.0, "loaded_to": 12.5, "end": 17.0}
    speed = math.radians(3.75)
    return LoadTest(1e-3 * grams, cast("Any", direction), speed=speed, **quick)


def judge(
    forceps: Plain,
    methods: Sequence[str],
    motion: str,
    masses_g: Sequence[float],
    directions: Sequence[str],
    number: int,
) -> PartResult:
    """Calibrate methods on one motion; judge them on (28), and in phase IV of each weight.

    The specimen's `number` is the seed of its noise, and of the hands that hang the weights.
    """
    plant = built(forceps)
    models = m.calibrated(plant, tuple(methods), number, motion)
    run = m.settled(record(plant, "verification", seed=2 * number + 1))
    errors = m.judge(models, run).errors()
    inside = {"unloaded": covered(models, run, m.SETTLED)}
    loaded: dict[str, dict[str, float]] = {key: {} for key in models}
    unseen = {}
    for mass in masses_g:
        for direction in directions:
            test, case = load_test(mass, direction), f"{mass:g} g {direction}"
            hung = record(plant, test, seed=100 * number + round(mass))
            first, last = test.phases["IV"]
            for key, error in m.judge(models, hung).errors(first, last).items():
                loaded[key][case] = error["rms"]
            inside[case] = covered(models, hung, first)
            unseen[case] = unseen_turn(plant, hung, test)
    numbers = {"floor": encoder_floor(plant, run), "unseen": unseen, "inside": inside}
    return PartResult({"unloaded": errors, "loaded": loaded, **numbers})


def encoder_floor(plant: ForcepsParameters, recording: Recording) -> float:
    """RMS [rad] of what the reference encoder adds to the jaw's angle that no estimate can know.

    Its harmonic error is the same at each angle, and learnt; noise and quantisation are not.
    """
    exact = recording.column("truth_exact/jaw")
    known = exact + reference_error(exact, plant.reference_encoder)
    return float(np.sqrt(np.nanmean((recording.column("truth/jaw") - known) ** 2)))


def unseen_turn(plant: ForcepsParameters, recording: Recording, test: LoadTest) -> float:
    """By how much a weight turns the jaw [rad] while neither motor nor reset encoder tells.

    0 where the reset encoder moves by as much as it resolves.
    """
    first, last = test.phases["IV"]
    before = m.within(recording.t, test.loaded_from - _BEFORE, test.loaded_from)
    after = m.within(recording.t, first, last)
    turned, moved = (
        abs(float(values[after].mean() - values[before].mean()))
        for values in map(recording.column, ("truth_exact/jaw", RESET))
    )
    return turned if moved < plant.reset_encoder.resolution else 0.0


def covered(models: Mapping[str, Calibration], recording: Recording, first: float) -> float | None:
    """Share of rows from `first` [s] on in which our default stays within what it states."""
    if m.BEST not in models:
        return None
    corrector = Corrector(models[m.BEST], level=LEVEL)
    corrector.set_homing(True, recording.provenance.homing_id)
    trace = corrector.run(recording)
    rows = trace.t > first
    error = np.abs(trace.position[:, 0] - recording.column("truth/jaw"))
    return float(np.mean(error[rows] <= trace.half_width[rows, 0]))


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Distribution of each method's errors, unloaded and in phase IV, and what ours states."""
    numbers = [result.numbers for result in results.values()]
    rms = {
        key: np.array([n["unloaded"][key]["rms"] for n in numbers])
        for key in numbers[0]["unloaded"]
    }
    loaded = {key: np.array([list(n["loaded"][key].values()) for n in numbers]) for key in rms}
    rows = []
    for key, errors in rms.items():
        held = f"{100 * np.mean(loaded[key] <= _HELD):.0f} %"
        cells = quantile_texts(errors, 0.5, 0.95, 1.0) + against_paper(rms, key)
        rows.append(
            (m.METHODS[key].title, *cells, *quantile_texts(loaded[key], 0.5, 0.9, 1.0), held)
        )
    header = (
        "method", "median", "95 %", "worst", "beats the UKF in", "median UKF / method",
        "IV median", "IV 90 %", "IV worst", "IV within 0.15 deg",
    )  # fmt: skip
    notes = (
        f"RMS error in degrees against the reference encoder, {len(results)} specimens of seed "
        f"{settings.seed}, prior {settings['prior']}, calibrated on the motion "
        f"{settings['motion']}: unloaded on (28); IV hung still, every weight and direction of "
        "every specimen a case (at twice the speed of IV-D).",
        *_floors(numbers, rms, loaded),
        *_stated(numbers),
        *m.left_out(settings, rms),
    )
    table = Table("Other frictions and sizes, and weights on the jaw", header, tuple(rows), notes)
    return Summary((table,), {"forceps-mixed": _figure(rms, loaded)})


def _floors(
    numbers: Sequence[Mapping[str, Any]], rms: Mapping[str, Array], loaded: Mapping[str, Array]
) -> tuple[str, ...]:
    """Tell what no estimate can pass: the reference encoder's noise, and loads unseen."""
    if not {m.BEST, m.PAPERS_BEST} <= set(rms):
        return ()
    floor = np.array([n["floor"] for n in numbers])
    paper, ours = rms[m.PAPERS_BEST], rms[m.BEST]
    beyond = np.sqrt(np.maximum([paper**2 - floor**2, ours**2 - floor**2], 1e-12))
    unseen = np.array([list(n["unseen"].values()) for n in numbers]) > _HELD
    seen = np.where(unseen, 0.0, loaded[m.BEST])
    return (
        "The reference encoder's noise and counts alone are "
        f"{degrees_text(float(np.median(floor)))} deg: without any error an estimate would have a "
        f"median ratio of {np.median(paper / floor):.2f}. Of what exceeds them, ours has one of "
        f"{np.median(beyond[0] / beyond[1]):.2f}.",
        f"In {100 * np.mean(unseen):.1f} % of the cases in phase IV the weight turned the jaw by "
        f"more than {math.degrees(_HELD):g} deg and neither motor nor x2 moved; but for these ours "
        f"holds {100 * np.mean(seen <= _HELD):.0f} % within that, the worst "
        f"{degrees_text(float(seen.max()))} deg.",
    )


def _stated(numbers: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """How often our default stays within what it states, if it was there."""
    if numbers[0]["inside"]["unloaded"] is None:
        return ()
    without = [n["inside"]["unloaded"] for n in numbers]
    under = [v for n in numbers for case, v in n["inside"].items() if case != "unloaded"]
    return (
        f"{m.METHODS[m.BEST].title}: a stated {100 * LEVEL:.0f} % holds in "
        f"{100 * np.mean(without):.0f} % of rows unloaded (worst specimen "
        f"{100 * min(without):.0f} %), in {100 * np.mean(under):.0f} % in phase IV.",
    )


def _figure(rms: Mapping[str, Array], loaded: Mapping[str, Array]) -> Figure:
    panels = []
    for errors, title in ((rms, "unloaded, (28)"), (loaded, "under a weight, phase IV")):
        curves = []
        for key, values in errors.items():
            sizes = np.sort(np.degrees(values), axis=None)
            below = (np.arange(sizes.size) + 0.5) / sizes.size
            method = m.METHODS[key]
            curves.append(Curve(sizes, below, method.title, method.colour or "0.7", width=1.2))
        panels.append(Panel(curves, "RMS error [deg]", "share of cases below", title, log="x"))
    caption = "Share of specimens, and of weights on specimens, with a smaller error, by method."
    title = "Virtual forceps of other frictions and sizes, against the encoder"
    return Figure(title, (panels,), caption, width=12.0, height=5.6, legend=True)
