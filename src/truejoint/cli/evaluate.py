"""`truejoint evaluate` and `check`: judge calibrations on recordings not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import truejoint
from truejoint.cli.console import command_line, out, print_table, progress, say
from truejoint.cli.driven_arm import BriefTruth
from truejoint.cli.options import Result, share
from truejoint.cli.recording_options import (
    DataCheck,
    Files,
    check_page_target,
    parse_tolerances,
    say_failed,
)
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError
from truejoint.units import with_unit

_STYLES: Final = {"pass": "green", "warn": "yellow", "fail": "red"}
_COLOURS: Final = {True: "green", False: "red", None: "yellow"}
_ADVICE: Final = {
    "shift": "efforts no longer fit the positions: was a load hung on, or a cable changed?",
    "friction": "friction has changed",
    "range": "many samples lie far outside what was trained",
    "work": "the arm has worked for long since it was last compared with the truth",
}


@dataclass(frozen=True)
class Judging:
    """How models are judged, and the page that says so, an option each."""

    tolerance: list[str] | None = None
    rezero_s: float = 0.0
    part: str | None = None
    split: str | None = None
    report: Path | None = None
    force: bool = False

    def __post_init__(self) -> None:
        check_page_target(self.report, self.force)


def evaluate(
    model: Path,
    recordings: list[str],
    how: Judging,
    data_check: DataCheck,
    files: Files,
    seeds: list[Path] | None = None,
) -> Result:
    """Judge a calibration on recordings with truth; exit code 1 when it does not pass.

    Several models are compared; exit code 1 then means that a test cannot be believed.
    """
    if others := [name for name in recordings if is_model(Path(name))]:
        if seeds:
            raise CalibrationError(f"--seed-of judges one model; leave out {', '.join(others)}")
        tests = [name for name in recordings if name not in others]
        return _compare([str(model), *others], tests, how, data_check, files)
    models = [truejoint.read_calibration(path) for path in (model, *(seeds or []))]
    first = models[0]
    if any(other.estimator != first.estimator for other in models):
        raise CalibrationError(
            f"--seed-of: {model} is {first.estimator!r}; give models of the same estimator"
        )
    accepted = parse_tolerances(how.tolerance, first)
    testing = files.find(
        recordings, part=how.part, split=how.split, model=first, inputs=first.feature_set
    )()
    check = data_check.run(testing, model=first)
    with progress("Judging"):
        result = truejoint.evaluate(
            models, testing, tolerance=accepted, rezero=how.rezero_s, check=check
        )
    if how.report is not None:
        with progress(f"Writing {how.report}"):
            truejoint.write_report(result, how.report, command=command_line(), overwrite=how.force)
    _show(result)
    say_failed(check)
    return Result(result.to_dict(), result.verdict.passed and not check.failed)


def _show(result: truejoint.evaluation.Evaluation) -> None:
    out.print(truejoint.evaluation.score_table(result))
    for name, note in result.baseline_notes.items():
        say(f"{name}: {note}")
    if not result.intervals.empty:
        out.print(truejoint.evaluation.interval_table(result))
    if not result.intervals.empty or result.interval_objections:
        for line in (result.interval_note, *result.interval_objections):
            say(line)
    if result.domain.inside < 1.0:
        out.print(truejoint.evaluation.domain_table(result))
    say(truejoint.evaluation.score_tables.domain_line(result))
    _show_verdict(result.verdict)
    if result.verdict.advice and result.verdict.advice not in result.verdict.doubts:
        out.print(result.verdict.advice)


def _show_verdict(verdict: truejoint.evaluation.Verdict, title: str = "") -> None:
    out.print(f"{title}{verdict.text}", style=_STYLES[verdict.level])
    for line in (*verdict.objections[1:], *verdict.doubts, *verdict.remarks):
        out.print(f"  {line}")


def _compare(
    paths: list[str], recordings: list[str], how: Judging, data_check: DataCheck, files: Files
) -> Result:
    if twice := sorted({path for path in paths if paths.count(path) > 1}):
        raise CalibrationError(f"{', '.join(twice)}: named twice; give each model once")
    if not recordings:
        raise CalibrationError(
            "name recordings with truth to judge the models on, after the models"
        )
    models = _by_title(paths)
    first = next(iter(models.values()))
    accepted = parse_tolerances(how.tolerance, first)
    tested = files.find(recordings, part=how.part, split=how.split, model=first)()
    check = data_check.run(tested, model=first)
    judge = partial(
        truejoint.evaluate, recordings=tested, tolerance=accepted, rezero=how.rezero_s, check=check
    )
    with progress(f"Judging {len(models)} models"):
        together = judge({title: [model] for title, model in models.items()})
        alone = {title: judge(model) for title, model in models.items()}
    if how.report is not None:
        with progress(f"Writing {how.report}"):
            truejoint.evaluation.write_comparison(
                together, alone, how.report, command=command_line(), overwrite=how.force
            )
    objections = [
        f"{title}: {objection}"
        for title, evaluation in alone.items()
        for objection in evaluation.verdict.objections
    ]
    out.print(truejoint.evaluation.score_table(together))
    best = {}
    for joint in together.joints:
        score = min((together.score(title, joint) for title in alone), key=lambda s: s.rmse)
        best[joint] = score.estimator
        out.print(f"{joint}: {score.estimator} is best, {with_unit(score.rmse, score.unit)}")
    for title, evaluation in alone.items():
        _show_verdict(evaluation.verdict, f"{title}: ")
    if together.verdict.advice and not objections:
        out.print(together.verdict.advice)
    say_failed(check)
    values = {
        "check": check.to_dict(),
        "scores": together.to_dict()["scores"],
        "best": best,
        "deploy": "" if objections else together.verdict.deploy,
        "advice": "" if objections else together.verdict.advice,
        "verdicts": {title: judged.to_dict()["verdict"] for title, judged in alone.items()},
        "objections": objections,
    }
    return Result(values, passed=not objections and not check.failed)


def _by_title(paths: Sequence[str]) -> dict[str, truejoint.Calibration]:
    """Read models by file and estimator; those whose files are called alike go by their paths."""
    stems, models = [Path(path).stem for path in paths], {}
    for path, stem in zip(paths, stems, strict=True):
        model = truejoint.read_calibration(path)
        estimator = "auto" if "choice" in model.metadata else model.estimator
        models[f"{path if stems.count(stem) > 1 else stem} ({estimator})"] = model
    return models


def check(
    model: Path,
    files: Files,
    live: BriefTruth,
    recording: str | None = None,
    level_percent: float | None = None,
) -> Result:
    """Say how far off a calibration is now; exit code 1 when its interval no longer holds."""
    stated = share(level_percent)
    calibration = truejoint.read_calibration(model)
    loaded = live.read(recording, files, calibration)
    with progress("Comparing with the truth"):
        result = truejoint.runtime.check_calibration(calibration, loaded, stated)
    rows = []
    for joint in result.joints:
        values = (joint.rmse, joint.offset, joint.offset_sd, joint.rezeroed_rmse, joint.half_width)
        rmse, offset, offset_sd, residual, half_width = (with_unit(v, joint.unit) for v in values)
        inside = "-" if joint.holds is None else f"{100 * joint.inside:.0f} %"
        rows.append(
            (joint.joint, rmse, f"{offset} ± {offset_sd}", residual, f"± {half_width}", inside)
        )
    header = ("joint", "error RMS", "offset", "left after re-zeroing", "interval", "inside")
    print_table(header, rows, title=f"{calibration.estimator} of {calibration.title}, now")
    out.print(f"{result.rows} readings of the truth over {result.duration:.1f} s")
    if calibration.interval is not None:
        out.print(f"The interval is {calibration.interval.meaning}")
    out.print(_verdict(result), style=_COLOURS[result.holds])
    facts = result.to_dict()
    for name in facts["reasons"]:
        say(f"monitor: {_ADVICE[name]}")
    return Result(facts, passed=result.holds is not False)


def _verdict(result: truejoint.runtime.CalibrationCheck) -> str:
    stated = f"The {100 * result.level:g} % interval"
    worst = ", ".join(joint.joint for joint in result.joints if joint.holds is False)
    verdicts = {
        None: "No verdict: the model states no interval. Make one with "
        "`truejoint calibrate ... --interval RECORDING`.",
        True: f"{stated} holds: most readings lie inside it in every joint.",
        False: f"{stated} no longer holds in {worst}: most readings lie outside it. Re-zero it "
        "(`truejoint rezero`), or calibrate anew where much is left after re-zeroing.",
    }
    return verdicts[result.holds]
