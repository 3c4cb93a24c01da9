"""`truejoint demo`: the whole way on a simulated RAVEN-II, from homing to a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli.calibrate import configured, fit
from truejoint.cli.collect import record
from truejoint.cli.console import out, progress, result_json, say
from truejoint.cli.evaluate import CHECK_FAILED, report_evaluation, show
from truejoint.cli.options import Json, Seed
from truejoint.estimators.registry import DEFAULT

# The calibration of peng2024, II-E: direction J2-J3 with three sparsities, judged on 20 minutes
# of random motion.
DIRECTION = "J2-J3"
SPARSITIES = (4, 5, 6)


def demo(
    folder: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for everything that is made.")
    ] = Path("demo"),
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Home, move, record, calibrate, judge and correct a simulated RAVEN-II.

    Writes trajectories, recordings, the model and the report, and overwrites those of an
    earlier demo.
    """
    folder.mkdir(parents=True, exist_ok=True)
    say("1. Compiling the simulated RAVEN-II (once) and homing its left arm ...")
    arm = truejoint.crtk.simulated_arm("raven2", "left", seed=seed)
    arm.enable()
    arm.home()
    say(f"   {arm.operating_state()}")

    def recorded(path: truejoint.motion.Trajectory, name: str, label: str) -> truejoint.Recording:
        truejoint.motion.write_trajectory(path, folder / f"{name}.csv", overwrite=True)
        recording, report = record(arm, path, folder / f"{name}.parquet", label=label)
        say(f"   {len(recording)} rows; {report}")
        return recording

    say(f"2. Zig-zags in direction {DIRECTION}, temporary encoders on the joints")
    training = []
    for n in SPARSITIES:
        name = f"zigzag_{DIRECTION}_1_{n}"
        path = truejoint.motion.zigzag(arm.robot, DIRECTION, 1 / n)
        training.append(recorded(path, name, f"   Following {name}"))

    say("3. Twenty minutes of random motion, which the model will never see")
    motion = truejoint.motion.random_motion(arm.robot, seed=seed)
    test = recorded(motion, "random", "   Following the random motion")

    say("4. The network of peng2024 and, beside it, offset, linear and polynomial regression")
    model, _ = fit(training, configured(DEFAULT, []), random_state=seed)
    truejoint.write_calibration(model, folder / "left_arm.safetensors", overwrite=True)

    say("5. Judging it on the random motion")
    with progress("   Correcting and comparing with the joint encoders"):
        result = truejoint.evaluate(model, test)
    report_evaluation(result, folder / "report.html", model, training, force=True)
    if as_json:
        result_json(result.to_dict())
    else:
        show(result)
        out.print(
            f"\nOpen {folder / 'report.html'} in a browser.\n"
            f"Correct a recording in Python:\n"
            f"  import truejoint\n"
            f"  model = truejoint.read_calibration({str(folder / 'left_arm.safetensors')!r})\n"
            f"  recording = truejoint.read_recording({str(folder / 'random.parquet')!r})\n"
            f"  corrected = model.correct(recording)  # shoulder, elbow [rad], insertion [m]",
        )
    if not result.verdict.passed:
        raise typer.Exit(CHECK_FAILED)
