"""`truejoint adapt`: change a calibration as far as a few new recordings say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import truejoint
from truejoint.cli import options
from truejoint.cli.calibrate import Accuracy, checked_or_exit, finish, with_accuracy
from truejoint.cli.console import command_line, out, progress, result_json
from truejoint.cli.recording_options import Files, check_model_target
from truejoint.errors import CalibrationError


@options.takes(accuracy=Accuracy, files=Files)
def adapt(
    model: Path,
    recordings: list[str],
    output: Path,
    *,
    reference: list[str] | None = None,
    fit_rate_hz: float | None = None,
    weights_mm: float | None = None,
    accuracy: Accuracy,
    accept: list[str] | None = None,
    part: str | None = None,
    force: bool = False,
    as_json: bool = False,
    files: Files,
) -> None:
    """Adapt a calibration to another day, tool or arm of the same robot.

    A minute of recording changes the coefficients of linear, poly2, poly2_ridge and rich_play. A
    few seconds change the zero of any model. Estimator, features, joints and target stay.
    """
    check_model_target(output, force)
    if accuracy.is_cross:
        raise CalibrationError("--interval cross needs `truejoint calibrate`; name recordings")
    calibration = truejoint.read_calibration(model)
    if weights_mm is not None:
        if reference or accept or fit_rate_hz or accuracy != Accuracy():
            raise CalibrationError(
                "--weights-mm takes the recordings of the weights, --part and metadata alone"
            )
        loaded = files.find(recordings, part=part, model=calibration)()
        _stiffness(calibration, loaded, weights_mm / 1e3, output, force=force, as_json=as_json)
        return
    read_training = files.find(recordings, part=part, model=calibration)
    read_others = [files.find(names) for names in (*accuracy.names, reference or [])]
    training, (testing, unseen, before) = read_training(), (read() for read in read_others)
    check = checked_or_exit(training, accept, calibration.joints, as_json=as_json)
    adapted = truejoint.calibration.adapted(
        calibration, training, reference=before, fit_rate=fit_rate_hz
    ).with_metadata(command=command_line())
    adapted = with_accuracy(adapted, unseen, testing, accuracy.interval_rezero_s)
    finish(adapted, check, output, force=force, as_json=as_json)


def _stiffness(
    calibration: truejoint.Calibration,
    loaded: Sequence[truejoint.Recording],
    lever: float,
    output: Path,
    *,
    force: bool,
    as_json: bool,
) -> None:
    with progress("Identifying the stiffness"):
        stiff, stiffness = truejoint.calibration.with_stiffness(calibration, loaded, lever)
    truejoint.write_calibration(stiff, output, overwrite=force)
    if as_json:
        result_json({"model": str(output), **vars(stiffness)})
        return
    out.print(
        f"K_d = {stiffness.drive_stiffness / 1e3:.2f} ± {stiffness.deviation / 1e3:.2f} kN/m, "
        f"growing by {stiffness.growth:.0f} N/m per N of tension"
    )
    friction = 2e3 * stiff.model.jaw_friction
    out.print(f"Friction may hide up to {friction:.1f} mNm against the last motion")
    out.print(f"{output}: the model with this stiffness")
