"""`truejoint collect`: drive an arm along trajectories and record it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import truejoint
from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.inputs import read_trajectory, say_dropped
from truejoint.cli.options import Arm as ArmOption
from truejoint.cli.options import Force, Json, RobotName, Seed
from truejoint.errors import RecordingError
from truejoint.files import check_target
from truejoint.robots.catalogue import DEFAULT


def record(
    arm: truejoint.crtk.Arm,
    trajectory: truejoint.motion.Trajectory,
    target: Path,
    *,
    load: float = 0.0,
    state_rate: float = 30.0,
    label: str | None = None,
    overwrite: bool = False,
) -> tuple[truejoint.Recording, truejoint.motion.TrackingReport]:
    """Follow a trajectory with a homed arm and write what it does, showing progress.

    Whatever stops the motion, what was recorded until then is kept, under a name of its own.
    """
    recorder = truejoint.recordings.Recorder(
        arm,
        state_rate=state_rate,
        path=target,
        overwrite=overwrite,
        session=trajectory.name,
        load=load,
        command=command_line(),
    )
    try:
        with progress(label or f"Following {trajectory.name}") as done, recorder:
            report = truejoint.motion.follow(arm, trajectory, progress=done)
    except BaseException:
        if recorder.written is not None:
            say(f"stopped; what was recorded until then is in {recorder.written}")
        raise
    return recorder.recording(str(target)), report


def collect(
    trajectories: Annotated[
        list[Path], typer.Argument(metavar="TRAJECTORY...", help="Trajectory files, in order.")
    ],
    output: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for one Parquet file a trajectory.")
    ],
    robot: RobotName = DEFAULT,
    arm: ArmOption = "",
    seed: Seed = 0,
    load_grams: Annotated[float, typer.Option(help="Mass hung on the tool [g].")] = 0.0,
    state_rate_hz: Annotated[float, typer.Option(help="Rate of the recorded state [Hz].")] = 30.0,
    twin: Annotated[
        str,
        typer.Option(
            help="Specimen of the simulated robot, such as peng2024, or a TOML file with its "
            "parameters."
        ),
    ] = "nominal",
    real_time: Annotated[
        bool, typer.Option("--real-time", help="At the pace of the wall clock, as a robot does.")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Leave out trajectories that are recorded already.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Home a simulated arm, drive it along trajectories and record each.

    All trajectories of one call share one homing, as in one session with a robot. A recording in
    place of a trajectory is replayed: the arm follows the set-points in it. Whatever stops the
    command leaves what was recorded; with --resume the same command goes on after it.
    """
    targets = [output / f"{path.stem}.parquet" for path in trajectories]
    if resume:
        done = [target for target in targets if _is_recorded(target)]
        for target in done:
            say(f"{target}: recorded already")
        pairs = zip(trajectories, targets, strict=True)
        trajectories = [path for path, target in pairs if target not in done]
        targets = [target for target in targets if target not in done]
    loaded = [read_trajectory(path) for path in trajectories]
    for target in targets:  # refused before the robot moves, not after
        if targets.count(target) > 1:
            raise RecordingError(
                f"{target}: two trajectories have the same file name; rename one of them"
            )
        check_target(target, overwrite=force, makes_folder=True)
    made = truejoint.simulation.make_twin(
        robot, arm, parameters=twin, seed=seed, load=load_grams / 1e3
    )
    kind = truejoint.crtk.PacedBackend if real_time else truejoint.crtk.SimulatedBackend
    device = truejoint.crtk.Arm(kind(made))
    for trajectory in loaded:
        trajectory.check_within(device.robot)
    say(f"Homing {device.robot.title}, simulated ...")
    output.mkdir(parents=True, exist_ok=True)
    device.enable()
    device.home()
    rows = []
    for trajectory, target in zip(loaded, targets, strict=True):
        recording, report = record(
            device,
            trajectory,
            target,
            load=load_grams / 1e3,
            state_rate=state_rate_hz,
            overwrite=force,
        )
        facts = {"file": str(target), "rows": len(recording), "tracking": report.to_dict()}
        rows.append({**facts, "dropped": dict(recording.provenance.dropped)})
        if not as_json:
            size = target.stat().st_size / 1e6
            out.print(f"{target}: {len(recording)} rows, {size:.1f} MB; {report}")
            say_dropped(recording)
    device.close()
    if as_json:
        result_json({"recordings": rows})


def _is_recorded(target: Path) -> bool:
    """Whether a whole recording is there; raises RecordingError for a file that is none."""
    return target.exists() and len(truejoint.recordings.read_parquet(target)) > 0
