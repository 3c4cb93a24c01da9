"""Specimens of the forceps and their recordings, and the estimators that its studies compare."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from numpy.typing import ArrayLike
from pandas import DataFrame

from truejoint.array_types import Array, Mask
from truejoint.calibration import Calibration, calibrate
from truejoint.errors import StudyError, TruejointError
from truejoint.estimators.jaw.signals import DRIVE, MOTOR, RESET
from truejoint.features.feature_set import time_steps
from truejoint.motion import Trajectory, nested_motion
from truejoint.motion import forceps_trajectories as paths
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.simulation.forceps.load import LoadTest, SwingingLoad
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.twin import ZeroShift, simulate_forceps
from truejoint.studies.study import Plain, Rows, Settings
from truejoint.toml_file import shipped_table

_TONES: Final = paths.CALIBRATION_TONES
_TRAJECTORIES: Final[Mapping[str, Callable[[], Trajectory]]] = {
    "calibration": paths.calibration_trajectory,
    "verification": paths.verification_trajectory,
    "nested": lambda: nested_motion(get_robot("forceps"), rate=1000.0),
    "cycle": lambda: paths.sine_trajectory(_TONES, 2.0 * math.pi / _TONES[0][1]),
}


def tensioned(plant: ForcepsParameters, factor: float) -> ForcepsParameters:
    """Specimen whose cables are `factor` times as tense: the same ropes, as stiff as that makes.

    A rope's stiffness grows with its tension along one line, of which `Cable` states the slope at
    the pretension. Raises TruejointError where a specimen cannot be that tense.
    """
    values: dict[str, Any] = {"assembly.pretension": factor * plant.assembly.pretension}
    for name in ("drive_cable", "reset_cable"):
        cable = getattr(plant, name)
        growth = 1.0 + cable.stiffening * (factor - 1.0)
        values[f"{name}.stiffness"] = growth * cable.stiffness
        values[f"{name}.stiffening"] = factor / growth * cable.stiffening
    return plant.with_values(values)


def trajectory(name: str) -> Trajectory:
    """Trajectory of a motion; raises TruejointError for a name that is none."""
    if name not in _TRAJECTORIES:
        names = ", ".join(_TRAJECTORIES)
        raise TruejointError(f"no motion {name!r:.60}; choose one of {names}, or a load test")
    return _TRAJECTORIES[name]()


def drawn_specimens(settings: Settings) -> list[tuple[str, Plain, int]]:
    """Specimens that a study is made on, each with a name and a seed of its own.

    The one named by the option ``specimen``, or as many of a population as ``count`` says.
    """
    if not settings["count"]:
        name = settings["specimen"]
        plain = ForcepsParameters.read(name).to_dict()
        return [(f"specimen-{Path(name).stem}", plain, settings.seed)]
    plants = population(settings["count"], settings.seed, settings["prior"])
    return [(f"specimen-{n:05d}", plant.to_dict(), n) for n, plant in enumerate(plants)]


def load_test(mass: float, direction: str, *, quick: bool = False, **how: float) -> LoadTest:
    """Load test of a weight [kg]; raises TruejointError for one that cannot be.

    A `quick` one turns at twice the paper's speed and waits less.
    """
    brief = {"speed": math.radians(3.75), "start": 1.0, "loaded_from": 10.0, "loaded_to": 12.5}
    return LoadTest(mass, cast("Any", direction), **(brief | how if quick else how))


def changed(recording: Recording, name: str, values: ArrayLike) -> Recording:
    """Put another column `name` (n,) into a recording."""
    table = recording.table.assign(**{name: np.asarray(values, dtype=np.float64)})
    return Recording(table, recording.units, recording.provenance)


def signals(recording: Recording, *names: str) -> tuple[Array, Array]:
    """Columns (n, k), motor angle and ``x2`` by default, and time since the row before (n,) [s]."""
    X = np.column_stack([recording.column(name) for name in names or (MOTOR, RESET)])
    return X, time_steps(recording.t, np.inf)


def record_forceps(
    parameters: ForcepsParameters,
    motion: str | ArrayLike | LoadTest,
    *,
    seed: int = 0,
    log_rate: float = 200.0,
    zero_shift: ZeroShift = ZeroShift(),  # noqa: B008  # frozen
    load: SwingingLoad = SwingingLoad(0.0),  # noqa: B008  # frozen
) -> Recording:
    """Record a motion of the virtual forceps: what a laboratory would have of it, and its truth.

    The motion is one of the paper, ``"calibration"``, (27), ``"verification"``, (28), ``"cycle"``,
    a period of (27), or the load test of IV-D; or ``"nested"``, our own `nested_motion`; or angles.
    Other arguments, and what is raised, are those of `simulate_forceps`.

    Columns are ``measured/jaw`` (the motor's angle seen at the jaw, ``R phi_m / (z_i r)``),
    ``setpoint/jaw``, ``motor/jaw`` [rad], ``cable/drive`` and ``cable/reset`` (``x1`` and ``x2``
    [m], each only where its encoder is installed), ``truth/jaw`` (reference encoder, the paper's
    truth), ``truth_exact/jaw`` (what no laboratory has), ``truth_load/jaw`` (external torque [Nm])
    and the cables' tensions ``truth_tension/drive`` and ``truth_tension/reset`` [N].
    """
    path, mass, session, notes = motion, load.mass, "", ""
    if isinstance(motion, LoadTest):
        session = f"load {seed}"
        mass, angle = motion.mass, math.degrees(motion.angle)
        notes = f"load test: {1e3 * mass:g} g {motion.direction} the motion to {angle:g} deg"
    elif isinstance(motion, str):
        session, path = f"{motion} {seed}", trajectory(motion).positions[:, 0]
    run = simulate_forceps(
        parameters,
        cast("Any", path),
        seed=seed,
        log_rate=log_rate,
        zero_shift=zero_shift,
        load=load,
    )
    columns = {
        "t": run.t,
        **{name: values for name, values in run.columns().items() if "velocity" not in name},
        "truth/jaw": run.truth.position[:, 0],
    }
    provenance = Provenance(
        robot="forceps",
        source=f"virtual forceps, seed {seed}",
        session=session,
        homing_id=f"zero shift: motor {zero_shift.motor * 1e3:.4f} mrad, "
        f"drive {zero_shift.drive * 1e6:.3f} um, reset {zero_shift.reset * 1e6:.3f} um",
        load=mass,
        rates={"state": 1.0 / float(run.t[1] - run.t[0])},
        notes=notes,
    )
    robot = replace(
        get_robot("forceps"), mechanism=parameters.mechanism.mechanism(), transmission=None
    )
    return Recording.from_columns(columns, provenance, robot=robot)


record = lru_cache(maxsize=16)(record_forceps)
"""`record_forceps`, kept: several methods learn from one recording; half a megabyte each."""

SETTLED: Final = 2.2
"""Time from which errors count [s]: the motion swells for the first 2 s."""


@dataclass(frozen=True)
class Method:
    """One row of the tables: an estimator, columns that it takes, and its colour in figures."""

    title: str
    inputs: tuple[str, ...]
    colour: str = "0.7"
    estimator: str = ""  # where that is not the method's key

    @property
    def sensors(self) -> tuple[str, ...]:
        """Where sensors must sit: one on a cable is strategy 2 of yan2020, II-B, both are 3."""
        cables = ((DRIVE, "x1"), (RESET, "x2"))
        return ("motor", *(x for name, x in cables if name in self.inputs))


_ROWS: Final = shipped_table(__package__, "methods.toml")
METHODS: Final = {key: Method(**row) for key, row in _ROWS.items()}
"""By the key that stands in options and numbers, in the order of the tables."""
TITLES: Final = {key: method.title for key, method in METHODS.items()}
COLOURS: Final = {method.title: method.colour for method in METHODS.values()}
"""By the title of a method."""

BEST: Final = "play_gated"
"""What to calibrate a forceps with: of ours that stay right under a load, the most exact."""
PAPERS_BEST: Final = "ukf_compensated"
PAPERS: Final = ("lsm", "lsm_compensated", PAPERS_BEST)
"""The methods of the paper, worst first as it finds them."""


def common_arguments(settings: Settings) -> dict[str, Any]:
    """Specimen, methods and seed, which most parts take."""
    settings.check_names("method", "methods", METHODS)
    plant = ForcepsParameters.read(settings["specimen"])
    forceps = tensioned(plant, cast("float", settings.options.get("tension", 1.0))).to_dict()
    return {"forceps": forceps, "methods": settings["methods"], "seed": settings.seed}


def settled(recording: Recording) -> Recording:
    """Take the truth before `SETTLED` away, so that those rows neither teach nor count."""
    truth = np.where(recording.t > SETTLED, recording.column("truth/jaw"), np.nan)
    return changed(recording, "truth/jaw", truth)


@lru_cache(maxsize=4)
def calibrated(
    forceps: ForcepsParameters, methods: tuple[str, ...], seed: int, motion: str = "calibration"
) -> dict[str, Calibration]:
    """Calibrations of a specimen on a motion, (27), by method; parts of one process share them.

    Methods whose sensor is not installed are left out; raises StudyError when none is left.
    """
    recording = settled(record(forceps, motion, seed=2 * seed))
    models = {
        key: calibrate(
            recording,
            METHODS[key].estimator or key,
            features=METHODS[key].inputs,
            target="error" if key == "rigid" else "position",
        )
        for key in methods
        if set(METHODS[key].inputs) <= set(recording.units)
    }
    if not models:
        raise StudyError(f"no sensors for {', '.join(methods)}; install one, or choose others")
    return models


def rms(errors: Any) -> float:
    """Root mean square of errors (n,)."""
    return float(np.sqrt(np.mean(np.square(errors))))


def within(t: Array, first: float, last: float) -> Mask:
    """Rows (n,) from `first` to `last` [s]."""
    return np.asarray((t >= first) & (t <= last))


def judge(models: Mapping[str, Calibration], recording: Recording) -> dict[str, Array]:
    """Estimate the jaw's angle (n,) [rad] by each method, on a recording that none of them saw.

    In the rows that have a truth; beside are their ``t`` [s], that ``truth``, which the reference
    encoder reads, as in the paper, and the jaw itself, ``exact``.
    """
    truth = recording.column("truth/jaw")
    columns = {"t": recording.t, "truth": truth, "exact": recording.column("truth_exact/jaw")}
    columns |= {key: model.correct(recording)[:, 0] for key, model in models.items()}
    return {name: values[np.isfinite(truth)] for name, values in columns.items()}


def errors(
    judged: Mapping[str, Array], first: float = -np.inf, last: float = np.inf, **labels: Any
) -> Rows:
    """Estimate minus truth from `first` to `last` [s], a row a method, with the `labels`.

    ``rms``, ``largest`` and ``smallest`` are against the reference encoder; ``exact_rms`` is
    against the jaw itself, so it holds the encoder's own error [rad]; ``deviation`` is the error's
    standard deviation [rad].
    """
    chosen, rows = within(judged["t"], first, last), Rows()
    for key in filter(METHODS.__contains__, judged):
        error, exact = ((judged[key] - judged[name])[chosen] for name in ("truth", "exact"))
        sizes = {"rms": rms(error), "largest": float(error.max())}
        sizes |= {"smallest": float(error.min()), "exact_rms": rms(exact)}
        sizes["deviation"] = float(error.std())
        rows.append({**labels, "method": key, **sizes})
    return rows


def note_left_out(settings: Settings, rows: DataFrame) -> tuple[str, ...]:
    """Note on the methods that were asked for and have no rows, if there are any."""
    names = [TITLES[key] for key in settings["methods"] if key not in set(rows.method)]
    return (f"Left out, since a sensor is not installed: {', '.join(names)}.",) if names else ()
