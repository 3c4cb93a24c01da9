"""Whether a filter on (10), (11) of yan2020 with friction in physical parameters earns its place.

The jaw and the slider move so slowly that their inertia does not tell, so both equations are a
balance of forces; friction at either is Dahl's, a bristle that yields at Coulomb's level. Unknown
are those levels, the distances in which they build up, and the cables' stiffness: five parameters,
found in the calibration motion beside polynomials for what geometry and the reference encoder add.
The filter's state is both frictions and a load.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.drawing import Curve, Figure, Panel
from truejoint.estimators.filtered import run_histories
from truejoint.filters import StateSpaceModel, UnscentedFilter
from truejoint.recordings import Recording
from truejoint.robots.forceps import Forceps
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.load import signals
from truejoint.studies.forceps.loaded import cases, load_test
from truejoint.studies.forceps.motions import Plain, built, drawn_specimens, record
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.tables import Table, median_text

OURS: Final = "ukf_friction"
PHYSICAL: Final = "physical"
_COMPARED: Final = (m.PAPERS_BEST, OURS)
_TITLES: Final = {PHYSICAL: "(10), (11) with Dahl friction"}
_POWERS: Final = 5  # of the motor's side, in what geometry adds
_STEPS: Final = 4  # in which a row's motion builds friction up
_START: Final = (14e3, 3e-3, 0.2, 1e-3, 1e-5)
_LOWEST: Final = (3e3, 1e-5, 1e-3, 1e-4, 5e-7)
_HIGHEST: Final = (4e4, 5e-2, 5.0, 2e-2, 5e-4)
"""Stiffness of both cables [N/m], friction of jaw [Nm] and slider [N], and the distances in which
they build up [rad, m]: where the search begins, and its range."""
_ANGLE_NOISE: Final = 6e-4  # of the reference encoder [rad]
_PLACE_NOISE: Final = 3e-6  # that geometry leaves of x2 [m]
_DRIFT: Final = 0.05  # of a friction, in its own size, per square root of a second
_LOAD_DRIFT: Final = 2e-3  # [Nm per square root of a second]
_REPEATED: Final = 20.0  # rows for which a misfit stays the same


@compiled
def place(drive: float, torque: float, friction: float, p: Array) -> float:
    """``x2`` [m] in balance, of ``x1`` [m], the `torque` that holds the jaw and the slider's force.

    `p` is stiffness, both frictions, both distances, the spring's stiffness and the jaw's radius.
    """
    half = 0.5 * (drive - torque / (p[6] * p[0]))
    return float((p[0] * half - friction) / (0.5 * p[0] + p[5]))


@compiled
def angle(drive: float, torque: float, friction: float, p: Array) -> float:
    """Jaw angle [rad] in balance; arguments as `place`."""
    reset = place(drive, torque, friction, p)
    return float(0.5 * (drive + reset - torque / (p[6] * p[0])) / p[6])


@compiled
def build_up(before: float, after: float, p: Array, held: Array) -> None:
    """Change frictions `held` (2,) [Nm, N] by the drive cable's motion between two places [m]."""
    step = (after - before) / _STEPS
    side = 1.0 if step > 0.0 else -1.0
    for _ in range(_STEPS if step != 0.0 else 0):
        jaw = p[1] / p[3] * max(1.0 - side * held[0] / p[1], 0.0)
        slider = p[2] / p[4] * max(1.0 - side * held[1] / p[2], 0.0)
        pull = p[0] * p[6]
        turned = pull * step / (2.0 * pull * p[6] + jaw - pull * pull / (p[0] + p[5] + slider))
        held[0] = min(max(held[0] + jaw * turned, -p[1]), p[1])
        moved = pull * turned / (p[0] + p[5] + slider)
        held[1] = min(max(held[1] + slider * moved, -p[2]), p[2])


@compiled
def simulate(drive: Array, p: Array, out: Array) -> None:
    """Angle [rad] and ``x2`` [m] into `out` (n, 2) along ``x1`` (n,), without a load."""
    held = np.zeros(2)
    for i in range(drive.shape[0]):
        build_up(drive[max(i - 1, 0)], drive[i], p, held)
        out[i, 0] = angle(drive[i], held[0], held[1], p)
        out[i, 1] = place(drive[i], held[0], held[1], p)


@compiled
def transition(x: Array, u: Array, _dt: float, p: Array, out: Array) -> None:
    """Build friction up along the drive cable's motion, ``u[0]`` to ``u[1]``; the load stays."""
    for i in range(3):
        out[i] = x[i]
    build_up(u[0], u[1], p, out)


@compiled
def measurement(x: Array, u: Array, p: Array, out: Array) -> None:
    """``x2`` [m] where the drive cable's is ``u[1]``."""
    out[0] = place(u[1], x[0] - x[2], x[1], p)


@dataclass(frozen=True)
class Identified:
    """What the calibration motion tells of a forceps."""

    mechanism: Forceps
    parameters: Array  # (7,), see `place`
    scale: float  # inverse largest drive displacement [1/m]
    angle: Array  # (5,), polynomial of what is left of the angle [rad]
    place: Array  # (5,), the same of x2 [m]
    misfit: float  # of x2 [m]

    def geometry(self, drive: Array) -> tuple[Array, Array]:
        """Give what geometry adds to angle [rad] and ``x2`` [m] (n,) at ``x1`` (n,) [m]."""
        powers = np.vander(drive * self.scale, _POWERS)
        return powers @ self.angle, powers @ self.place

    def estimate(self, run: Recording) -> Array:
        """Jaw angle (n,) [rad] by the filter."""
        X, dt = signals(run)
        drive = self.mechanism.drive_from_motor(X[:, 0])
        added, moved = self.geometry(drive)
        jaw, slider = self.parameters[1:3]
        model = StateSpaceModel(
            transition=transition,
            measurement=measurement,
            process_noise=np.diag([_DRIFT * jaw, _DRIFT * slider, _LOAD_DRIFT]) ** 2 * dt[-1],
            measurement_noise=[[self.misfit**2 * _REPEATED]],
            states=("jaw_friction", "slider_friction", "load"),
            measurements=("reset",),
            inputs=("drive_before", "drive"),
            parameters=self.parameters,
        )
        prior = np.zeros(3), np.diag([0.5 * jaw, 0.5 * slider, 1e-4]) ** 2
        control = np.column_stack([np.concatenate([drive[:1], drive[:-1]]), drive])
        seen = (X[:, 1] - moved)[:, None]
        states, _ = run_histories(UnscentedFilter(model), prior, seen, control, dt, smoothed=False)
        found = [
            angle(one, torque - load, friction, self.parameters)
            for one, (torque, friction, load) in zip(drive, states, strict=True)
        ]
        return np.array(found) + added


def identify(run: Recording, mechanism: Forceps) -> Identified:
    """Find the parameters in an unloaded motion, of its rows with the jaw's truth."""
    X, _ = signals(run)
    drive, truth = mechanism.drive_from_motor(X[:, 0]), run.column("truth/jaw")
    known, scale = np.isfinite(truth), float(1.0 / np.abs(drive).max())
    powers = np.vander(drive * scale, _POWERS)
    basis, out = np.linalg.qr(powers[known])[0], np.empty((len(drive), 2))
    fixed = [mechanism.spring_stiffness, mechanism.jaw_radius]

    def left(p: Array) -> tuple[Array, Array]:
        simulate(drive, p, out)
        return (truth - out[:, 0])[known], (X[:, 1] - out[:, 1])[known]

    def misfit(logarithms: Array) -> Array:
        residuals = left(np.concatenate([np.exp(logarithms), fixed]))
        own = [e - basis @ (basis.T @ e) for e in residuals]
        return np.concatenate([own[0] / _ANGLE_NOISE, own[1] / _PLACE_NOISE])[::5]

    bounds = np.log(_LOWEST), np.log(_HIGHEST)
    found = least_squares(misfit, np.log(_START), bounds=bounds, loss="soft_l1", max_nfev=40)
    parameters = np.concatenate([np.exp(found.x), fixed])
    turned, moved = (
        np.linalg.lstsq(powers[known], e)[0].astype(np.float64) for e in left(parameters)
    )
    spread = float(np.std(left(parameters)[1] - powers[known] @ moved))
    return Identified(mechanism, parameters, scale, turned, moved, max(spread, 1e-6))


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    hung, motion = list(cases(settings).values()), settings["motion"]
    return [
        Part(name, compare, {"forceps": plant, "seed": seed, "motion": motion, "hung": hung})
        for name, plant, seed in drawn_specimens(settings)
    ]


def compare(
    forceps: Plain, seed: int, motion: str, hung: Sequence[Mapping[str, Any]]
) -> PartResult:
    """RMS errors [rad] on (28), and still under each weight, beside two other filters."""
    plant = built(forceps)
    physical = identify(m.settled(record(plant, motion, seed=2 * seed)), plant.mechanism)
    models = m.calibrated(plant, _COMPARED, seed, motion)

    def judge(run: Recording, first: float, last: float) -> dict[str, float]:
        rows = m.within(run.t, first, last)
        error = (physical.estimate(run) - run.column("truth/jaw"))[rows]
        others = m.judge(models, run).errors(first, last)
        rms = {key: others[key]["rms"] for key in _COMPARED}
        return {PHYSICAL: float(np.sqrt(np.mean(error**2))), **rms}

    run = record(plant, "verification", seed=2 * seed + 1)
    weighed = []
    for case in hung:
        test = load_test(case["mass"], case["direction"])
        hanging = record(plant, test, seed=case["hand"])
        weighed.append({**case, "rms": judge(hanging, *test.phases["IV"])})
    parameters = physical.parameters[:5].tolist()
    unloaded = judge(run, m.SETTLED, float(run.t[-1]))
    return PartResult({"parameters": parameters, "unloaded": unloaded, "weighed": weighed})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Median and worst of each filter, unloaded and under the weights."""
    numbers = [result.numbers for result in results.values()]
    methods = (PHYSICAL, *_COMPARED)
    by_case = {"unloaded, (28)": {key: [n["unloaded"][key] for n in numbers] for key in methods}}
    for way in settings["directions"]:
        own = [c["rms"] for n in numbers for c in n["weighed"] if c["direction"] == way]
        by_case[f"still, load {way}"] = {key: [rms[key] for rms in own] for key in methods}
    rows = [
        (label, *(_spread(errors[key]) for key in methods)) for label, errors in by_case.items()
    ]
    titles = {**{key: m.METHODS[key].title for key in _COMPARED}, **_TITLES}
    notes = (
        f"RMS error in degrees against the reference encoder, median (worst) over {len(numbers)} "
        f"specimens, calibrated on {settings['motion']}; weights "
        f"{', '.join(f'{mass:g}' for mass in settings['masses_g'])} g.",
    )
    header = ("", *(titles[key] for key in methods))
    table = Table("Friction in physical parameters", header, tuple(rows), notes)
    place = np.arange(len(rows))
    curves = [
        Curve(
            [float(np.degrees(np.median(errors[key]))) for errors in by_case.values()],
            place,
            titles[key],
            style="o",
        )
        for key in methods
    ]
    panel = Panel(curves, "median RMS error [deg]", log="x", rows=list(by_case))
    figure = Figure(
        "Friction in physical parameters", ((panel,),), notes[0], height=3.6, legend=True
    )
    return Summary((table,), {"forceps-physical": figure})


def _spread(errors: Sequence[float]) -> str:
    return median_text(np.degrees(errors), 3)
