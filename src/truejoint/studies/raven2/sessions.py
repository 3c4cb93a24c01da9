"""Sessions on virtual RAVEN-II arms: homing, zig-zags to calibrate on, random tests."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.crtk import BLOCK_DURATION, Arm, SimulatedBackend
from truejoint.errors import StudyError
from truejoint.estimators import Regressor
from truejoint.evaluation.scoring import rmse
from truejoint.motion import DIRECTIONS, PROFILES, Trajectory, follow, random_motion, zigzag
from truejoint.recordings import Recorder, Recording
from truejoint.simulation.raven2 import Raven2Parameters, Raven2Twin
from truejoint.studies.study import Part, PartResult, Plain, Rows, Settings

Models = Mapping[str, Sequence[Calibration]]
"""Fitted models by method."""

JOINTS: Final = ("shoulder", "elbow", "insertion")
SCALES: Final = np.array([np.degrees(1.0), np.degrees(1.0), 1e3])
"""From rad, rad, m to the units of `TITLES`."""
TITLES: Final = ("shoulder [deg]", "elbow [deg]", "insertion [mm]")
MODELS: Final = ("dnn", "poly2", "linear")
METHODS: Final = (*MODELS, "offset", "raw")
CORRECTED: Final = METHODS[:-1]
TWO: Final = ("dnn", "linear")
"""What most claims are on."""
BEST: Final = "J2-J3"
"""Direction that peng2024 takes for all but Table I."""
PUBLISHED: Final = "published"
"""J1-J2-J3 in the box of the laboratory's own generator; see `zigzag`."""
HOUR: Final = 3600.0  # [s]
STATE_RATE: Final = 30.0  # [Hz], peng2024, IV-A
_LONG_RATE: Final = 5.0  # [Hz], of hours
_EXAMPLE: Final = 60.0  # [s] of the first hour that are drawn, as in peng2024, figure 7
_IDLE_TEST: Final = 120.0  # [s], short, as the tests work the cables as well
STUDY_SEED: Final = 1000
"""Between the arms' seeds of two seeds of a study."""
TEST_SEED: Final = 1_000_000
"""Between the seed of an arm and that of its test motion."""
IDLE, UNLOADED, LOADED = WORKS = ("idle", "unloaded", "loaded")
"""What the arm does for hours; the last with a mass on its tool."""


def specimens(names: Sequence[str]) -> dict[str, Plain]:
    """Plain values of shipped specimens, or of TOML files, by a title for each.

    Raises StudyError if two files have one name, TruejointError if one cannot be read.
    """
    plain: dict[str, Plain] = {
        Path(name).stem: Raven2Parameters.read(name).to_dict() for name in names
    }
    if len(plain) < len(names):
        raise StudyError(f"specimens {', '.join(names)}: two have one name; rename a file")
    return plain


def part_for_each(
    settings: Settings,
    compute: Callable[..., Rows | PartResult],
    offset: int,
    *names: str,
    more: Mapping[str, Any] | None = None,
    cases: Mapping[str, Mapping[str, Any]] | None = None,
    chosen: Sequence[str] | None = None,
) -> list[Part]:
    """Part of every specimen, session and case, labelled by these.

    `compute` is called with a specimen ``raven``, an arm's ``seed``, the options `names`, `more`,
    and what the case adds. `offset` keeps the arms' seeds from those of other studies;
    which cases are `chosen` changes no seed.
    """
    common, cases = {n: settings[n] for n in names} | dict(more or {}), cases or {"": {}}
    for text in common.get("sets", ()):
        combination(text)
    first = offset + STUDY_SEED * settings.seed
    return [
        Part(
            f"{title}-{case}-{session}" if case else f"{title}-{session}",
            compute,
            {"raven": raven, "seed": first + len(cases) * session + n, **common, **arguments},
            {"specimen": title, "session": session, "case": case},
        )
        for title, raven in specimens(settings["specimens"]).items()
        for session in range(settings["sessions"])
        for n, (case, arguments) in enumerate(cases.items())
        if chosen is None or case in chosen
    ]


def homed(raven: Plain, seed: int) -> tuple[Arm, Raven2Twin]:
    """Arm of a specimen that was just switched on and homed, and the twin behind it."""
    twin = Raven2Twin(Raven2Parameters.from_dict(raven), seed=seed)
    backend = SimulatedBackend(twin)
    backend.stretch = BLOCK_DURATION  # nobody stops it on the way
    arm = Arm(backend)
    arm.enable()
    arm.home()
    return arm, twin


def record(arm: Arm, trajectory: Trajectory, rate: float = STATE_RATE) -> Recording:
    """Record an arm along a trajectory, `rate` rows a second [Hz]."""
    with Recorder(arm, rate, session=trajectory.name) as recorder:
        follow(arm, trajectory)
    return recorder.recording()


def zigzags(arm: Arm, divisions: Sequence[int], direction: str = BEST) -> list[Recording]:
    """Record a zig-zag of each sparsity 1 / `divisions`."""
    published = direction == PUBLISHED
    named = DIRECTIONS[-1] if published else direction
    paths = [zigzag(arm.robot, named, 1.0 / n, published=published) for n in divisions]
    return [record(arm, path) for path in paths]


def combination(text: str) -> tuple[int, ...]:
    """Divisions of a combination of sparsities, such as ``"4+5+6"`` for 1/4, 1/5 and 1/6."""
    try:
        divisions = tuple(int(part) for part in text.split("+"))
    except ValueError:
        divisions = ()
    if not divisions or min(divisions) < 1 or len(set(divisions)) < len(divisions):
        raise StudyError(f"sparsities {text!r:.60}: write 4+5+6 for 1/4, 1/5 and 1/6 together")
    return divisions


def training_sets(
    arm: Arm, sets: Sequence[str], direction: str = BEST
) -> dict[str, list[Recording]]:
    """Zig-zags of every combination in `sets`; each sparsity is recorded once."""
    combinations = {text: combination(text) for text in sets}
    divisions = sorted({n for several in combinations.values() for n in several})
    recorded = dict(zip(divisions, zigzags(arm, divisions, direction), strict=True))
    return {text: [recorded[n] for n in several] for text, several in combinations.items()}


def seconds_of(training: Sequence[Recording]) -> float:
    """Time that recordings took [s]."""
    return sum(recording.duration for recording in training)


def random_test(arm: Arm, seconds: float, seed: int, rate: float = STATE_RATE) -> Recording:
    """Record random motion with the speed profile of the laboratory's controller."""
    path = random_motion(arm.robot, seconds, seed, profile=PROFILES[1])
    return record(arm, path, rate)


def model_of(
    training: Recording | Sequence[Recording], estimator: str | Regressor, **how: Any
) -> Calibration:
    """Calibrate for correcting recordings: what only checks a control loop's sensors is left out.

    `how` is as `calibrate` takes it.
    """
    return calibrate(training, estimator, redundant=(), **how)


def fitted(
    training: Sequence[Recording], networks: int, seed: int, **how: Any
) -> dict[str, list[Calibration]]:
    """Fit so many networks, the polynomial, the linear model and the fixed offset, by method.

    `how` is as `calibrate` takes it.
    """
    seeds = range(seed, seed + networks)
    models = [model_of(training, "dnn", random_state=each, **how) for each in seeds]
    first = models[0] if models else model_of(training, "linear", **how)
    baselines = {name: [model] for name, model in first.baselines.items()}
    return {"dnn": models, **baselines} if models else baselines


def calibrate_once(
    raven: Plain,
    seed: int,
    sets: Sequence[str],
    networks: int,
    *,
    direction: str = BEST,
    targets: Sequence[str] = ("error",),
    seconds: float = 0.0,
    hours: int = 0,
    works: Mapping[str, float] | None = None,
) -> PartResult:
    """Calibrate on each combination of zig-zags, and judge on all that follows.

    That is random motion of some `seconds`, or `hours` of kinds of work under a load [kg]; each of
    `works`, unloaded alone by default, begins right after the calibration. Of these arrays hold the
    first minute, named ``work/stream``: stamps (n,) [s], and joints (n, 3) as they are, as the
    robot measures them, and corrected by models of the longest training.
    """

    def calibrated() -> tuple[Arm, Raven2Twin, dict[str, list[Recording]]]:
        arm, twin = homed(raven, seed)
        return arm, twin, training_sets(arm, sets, direction)

    arm, twin, training = calibrated()
    lengths = {text: seconds_of(group) for text, group in training.items()}
    models = {
        (target, text): fitted(group, networks, seed, target=target)
        for target in targets
        for text, group in training.items()
    }
    longest = models[targets[0], max(lengths, key=lambda text: lengths[text])]
    test_seed, rows, arrays = TEST_SEED + seed, Rows(), dict[str, Array]()
    for n, (work, load) in enumerate((works or {UNLOADED: 0.0}).items()):
        if n:
            arm, twin, _ = calibrated()
        twin.load = load
        go_on = resting if work == IDLE else working
        tests = go_on(arm, hours, test_seed) if hours else [random_test(arm, seconds, test_seed)]
        for hour, test in enumerate(tests):
            for (target, text), several in models.items():
                if work != UNLOADED and target != targets[0]:
                    continue  # of which no paper says anything
                labels = {"work": work, "hour": hour, "target": target, "set": text}
                rows += judged(several, test, seconds=lengths[text], **labels)
        minute = tests[0].with_truth(JOINTS)
        minute = minute.rows(minute.t - minute.t[0] <= _EXAMPLE)
        example = {
            "t": minute.t - minute.t[0],
            "truth": minute.columns("truth", JOINTS),
            "raw": minute.columns("measured", JOINTS),
            **{name: several[0].correct(minute) for name, several in longest.items()},
        }
        arrays |= {f"{work}/{name}": values for name, values in example.items()}
    return PartResult(rows, arrays if hours else {})


def judged(models: Models, recording: Recording, **labels: Any) -> Rows:
    """RMSE of models, and of the raw positions, on a recording that none of them saw.

    A row holds the `labels`, ``method``, ``model`` (its number), ``joint`` and ``rmse`` [rad or m].
    """
    recording = recording.with_truth(JOINTS)
    truth = recording.columns("truth", JOINTS)
    errors = {
        (name, n): model.correct(recording) - truth
        for name, several in models.items()
        for n, model in enumerate(several)
    }
    errors["raw", 0] = recording.error(JOINTS)
    return [
        {**labels, "method": method, "model": n, "joint": joint, "rmse": value}
        for (method, n), error in errors.items()
        for joint, value in zip(JOINTS, rmse(error).tolist(), strict=True)
    ]


def working(arm: Arm, hours: int, seed: int) -> list[Recording]:
    """Random motion without a break, by hour; five rows a second are enough to judge by."""
    recording = random_test(arm, hours * HOUR, seed, _LONG_RATE)
    hour = np.minimum(((recording.t - recording.t[0]) / HOUR).astype(int), hours - 1)
    return [recording.rows(np.flatnonzero(hour == h)) for h in range(hours)]


def resting(arm: Arm, hours: int, seed: int) -> list[Recording]:
    """Two minutes of random motion at the start of every hour, the brakes on in between.

    The motion is the same each time, so that hours differ by what became of the arm.
    """
    tests = []
    for hour in range(hours):
        if hour:
            arm.disable()
            arm.wait(HOUR - _IDLE_TEST)
            arm.enable()
            arm.wait(1.0)  # until it has reported where it is now
        tests.append(random_test(arm, _IDLE_TEST, seed, _LONG_RATE))
    return tests
