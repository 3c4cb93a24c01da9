"""`truejoint demo`: the whole way on a simulated RAVEN-II, then on a recording of a real robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeAlias

import pandas as pd

import truejoint
from truejoint.cli.calibrate import configured, fit
from truejoint.cli.collect import record
from truejoint.cli.console import command_line, out, progress, say
from truejoint.cli.options import Result
from truejoint.cli.recording_options import DataCheck
from truejoint.errors import RecordingError
from truejoint.estimators.registry import NETWORK
from truejoint.evaluation.results import each
from truejoint.files import check_folder

# Three zig-zags between which all joints move; peng2024 judges each direction alone (II-E).
DIRECTIONS: Final = ("J1", "J2-J3", "J1-J2-J3")
SPARSITY: Final = 1 / 4
NETWORKS: Final = 3
TOLERANCE: Final = {
    "shoulder": math.radians(0.25), "elbow": math.radians(0.25), "insertion": 0.25e-3
}  # fmt: skip
REZERO: Final = 10.0  # s
LOAD: Final = 0.5  # kg (peng2024, II-G)
LEVEL: Final = 0.9
# So many short motions, each after a homing of its own, make the interval; the rest judge it.
MAKING: Final = 40
JUDGING: Final = 20
SHORT: Final = 1.5  # min
LONG: Final = 10.0  # min, of every test but the paper's
PAPER: Final = 20.0  # min (peng2024, II-E)
Recordings: TypeAlias = "list[truejoint.Recording]"
REAL: Final = "kuka_kr300_dual_encoder"  # the public one whose licence leaves nothing to ask


def demo(folder: Path = Path("demo"), seed: int = 0, force: bool = False) -> Result:
    """Home, move, record, calibrate, judge and correct a simulated RAVEN-II.

    Writes trajectories, recordings, the model and the report; with --force over those of an
    earlier demo. Exit code 1 when the network is not within the tolerance on random motion.
    """
    check_folder(folder)
    if folder.exists() and any(folder.iterdir()) and not force:
        raise RecordingError(f"{folder}: is not empty; choose another --out, or --force")
    folder.mkdir(parents=True, exist_ok=True)
    training, tests, head, short = _collected(folder, seed)
    say("6. The network of peng2024, and beside it offset, linear and polynomial regression")
    models = [fit(training, configured(NETWORK), random_state=seed + k) for k in range(NETWORKS)]
    models[0] = truejoint.calibration.with_interval(
        models[0], short[:MAKING], levels=[LEVEL], rezero=REZERO
    )
    truejoint.write_calibration(models[0], folder / "left_arm.safetensors", overwrite=True)
    find_zero = truejoint.calibration.find_zero
    today = [model.at(find_zero(model, head)) for model in models]

    say("7. Judging")
    same_homing = [tests["inside"], tests["all over"]]
    judged = {}
    for name, test in tests.items():
        fits = models if name in ("inside", "all over") else today
        judged[name] = truejoint.evaluate(fits, test, tolerance=TOLERANCE)
    after_homings = truejoint.evaluate(models[0], short[MAKING:])
    check = DataCheck().run(same_homing, model=models[0])
    whole = truejoint.evaluate(models, same_homing, tolerance=TOLERANCE, check=check)
    report = folder / "report.html"
    truejoint.write_report(whole, report, command=command_line(), overwrite=True)
    title = truejoint.recordings.datasets.DATASETS[REAL].title
    say(f"8. The same on a real robot: {title}")
    real = on_a_real_robot()
    errors, rows = (
        pd.concat([getattr(result, frame) for result in judged.values()], join="inner")
        for frame in ("errors", "rows")
    )
    advice = truejoint.evaluation.advise(errors, rows, judged["inside"].chosen)
    _show(judged, after_homings, advice.text)
    out.print(
        f"\nOpen {folder / 'report.html'} in a browser. In Python go on by docs/first_steps.md."
    )
    if isinstance(real, str):
        out.print(f"\nNo real recording: {real}")
    else:
        out.print(f"\n{title}: five lines of Python in docs/first_steps.md")
        out.print(truejoint.evaluation.score_table(real))
    interval = after_homings.intervals[["half_width", "coverage", "standard_error"]]
    values = {
        "tests": {name: result.to_dict()["scores"] for name, result in judged.items()},
        "tolerance": TOLERANCE, "interval": {"level": LEVEL, **interval.to_dict("list")},
        "deploy": advice.deploy, "passed": whole.verdict.passed,
        "real": real if isinstance(real, str) else real.to_dict()["scores"],
    }  # fmt: skip
    return Result(values, whole.verdict.passed)


def _collected(
    folder: Path, seed: int
) -> tuple[Recordings, dict[str, truejoint.Recording], truejoint.Recording, Recordings]:
    """Home and move a simulated arm, recording into `folder`.

    Gives the recordings to train on, those to judge on by name, the brief truth before that of the
    new homing, and the short ones.
    """
    say("1. Compiling the simulated RAVEN-II (once), one like peng2024's, and homing its left arm")
    twin = truejoint.simulation.make_twin("raven2", "left", parameters="peng2024", seed=seed)
    arm = truejoint.crtk.Arm(truejoint.crtk.SimulatedBackend(twin))
    arm.enable()
    arm.home()

    def recorded(path: truejoint.motion.Trajectory, name: str) -> truejoint.Recording:
        truejoint.motion.write_trajectory(path, folder / f"{name}.csv", overwrite=True)
        how: dict[str, Any] = {"load": twin.load, "label": f"   {path.name}", "overwrite": True}
        recording, report = record(arm, path, folder / f"{name}.parquet", **how)
        say(f"   {len(recording)} rows; {report}")
        return recording

    def at_random(minutes: float, k: int, **options: Any) -> truejoint.motion.Trajectory:
        motion = 1000 * seed + k
        return truejoint.motion.random_motion(
            arm.robot, 60 * minutes, motion, profile="laboratory", **options
        )

    say("2. Zig-zags for training, temporary encoders on the joints")
    training = [
        recorded(truejoint.motion.zigzag(arm.robot, direction, SPARSITY), f"zigzag_{direction}")
        for direction in DIRECTIONS
    ]
    what = "well inside the workspace, and the paper's, all over"
    say(f"3. Motions that the models never see: {what}")
    space = truejoint.motion.workspace_of(arm.robot)
    half, margin = space.extent / math.sqrt(12.0), space.swings[0] / math.sqrt(3.0)
    inner = replace(space, lower=space.centre - half, upper=space.centre + half, margin=margin)
    tests = {
        "inside": recorded(at_random(LONG, 0, workspace=inner), "inside"),
        "all over": recorded(at_random(PAPER, 1), "random"),
    }
    say(f"4. {MAKING + JUDGING} homings and {SHORT:g} min each, to state how far off it may be")
    short = []
    with progress("   Homing and moving") as done:
        for k in range(MAKING + JUDGING):
            arm.home()
            with truejoint.recordings.Recorder(arm, session=f"homing {k}") as recorder:
                truejoint.motion.follow(arm, at_random(SHORT, 100 + k))
            short.append(recorder.recording(f"homing {k}"))
            done((k + 1) / (MAKING + JUDGING))
    say(f"5. A new homing, then {1000 * LOAD:.0f} g on the tool")
    arm.home()
    morning = recorded(at_random(LONG, 2), "new_homing")
    head, tests["new homing"] = morning.rows(morning.t < REZERO), morning.rows(morning.t >= REZERO)
    twin.load = LOAD
    tests[f"{1000 * LOAD:.0f} g"] = recorded(at_random(LONG, 3), "loaded")
    return training, tests, head, short


def on_a_real_robot() -> truejoint.evaluation.Evaluation | str:
    """Calibrate one recording of a real robot and judge another, or say why not."""
    sets = truejoint.recordings.datasets
    about = sets.DATASETS[REAL]
    try:
        try:
            training, test = sets.read_dataset(REAL)
        except RecordingError:
            with progress(f"   Fetching {about.size / 1e6:.0f} MB") as done:
                sets.fetch(REAL, progress=done)
            training, test = sets.read_dataset(REAL)
    except RecordingError as error:
        return str(error)
    model = truejoint.calibrate(training, "linear", features=about.features)
    return truejoint.evaluate(model, test)


def _show(
    judged: Mapping[str, truejoint.evaluation.Evaluation],
    short: truejoint.evaluation.Evaluation,
    advice: str,
) -> None:
    """Print the tables, and what to deploy by the rule of every evaluation, over all tests."""
    meanings = (
        "the middle 58 % of every joint's range", "the paper's random motion",
        f"the first {REZERO:g} s of truth re-zero the model", "the same homing, loaded",
    )  # fmt: skip
    for (name, result), meaning in zip(judged.items(), meanings, strict=True):
        out.print(f"{name}: {meaning}", style="bold")
        out.print(truejoint.evaluation.score_table(result))
    motions = len(short.interval_trajectories)
    out.print(f"The network after any homing and {REZERO:g} s of truth, on {motions} motions:")
    out.print(truejoint.evaluation.interval_table(short))
    worst = []
    for name in dict.fromkeys((short.chosen, "linear")):
        share, where = max(
            (score.rmse / TOLERANCE[score.joint], f"{score.joint}, {test}")
            for test, result in judged.items()
            for score in each(result.scores)
            if score.estimator == name and score.joint in TOLERANCE
        )
        title = truejoint.evaluation.estimator_title(name)
        worst.append(f"{title}, at worst {100 * share:.0f} % of the tolerance ({where})")
    out.print(f"{advice} {'; '.join(worst)}.")
