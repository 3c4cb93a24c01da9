"""`truejoint adapt`: change a calibration as far as a few new recordings say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import truejoint
from truejoint.cli.calibrate import Accuracy, finish, refused
from truejoint.cli.check_options import DataCheck
from truejoint.cli.console import command_line, out, progress
from truejoint.cli.options import Result
from truejoint.cli.recording_options import Files, NewModel
from truejoint.errors import CalibrationError


def adapt(
    model: Path,
    recordings: list[str],
    new: NewModel,
    accuracy: Accuracy,
    data_check: DataCheck,
    files: Files,
    reference: list[str] | None = None,
    fit_rate_hz: float | None = None,
    weights_mm: float | None = None,
    part: str | None = None,
) -> Result:
    """Adapt a calibration to another day, tool or arm of the same robot.

    A minute of recording changes the coefficients of linear, poly2, poly2_ridge and rich_play. A
    few seconds change the zero of any model. Estimator, features, joints and target stay.
    """
    if accuracy.is_cross:
        raise CalibrationError("--interval cross needs `truejoint calibrate`; name recordings")
    calibration = truejoint.read_calibration(model)
    read_training = files.find(recordings, part=part, model=calibration)
    if weights_mm is not None:
        if reference or data_check.accept or fit_rate_hz or accuracy != Accuracy():
            raise CalibrationError(
                "--weights-mm takes the recordings of the weights, --part and metadata alone"
            )
        return _stiffness(calibration, read_training(), weights_mm / 1e3, new)
    read_others = [*accuracy.find(files), files.find(reference or [])]
    training, (*others, before) = read_training(), [read() for read in read_others]
    check = data_check.run(training, joints=calibration.joints)
    if check.failed:
        return refused(check)
    adapted = truejoint.calibration.adapted(
        calibration, training, reference=before, fit_rate=fit_rate_hz
    ).with_metadata(command=command_line())
    return finish(accuracy.stated_by(adapted, *others), check, new)


def _stiffness(
    calibration: truejoint.Calibration,
    loaded: Sequence[truejoint.Recording],
    lever: float,
    new: NewModel,
) -> Result:
    with progress("Identifying the stiffness"):
        stiff, stiffness = truejoint.calibration.with_stiffness(calibration, loaded, lever)
    new.write(stiff)
    out.print(
        f"K_d = {stiffness.drive_stiffness / 1e3:.2f} ± {stiffness.deviation / 1e3:.2f} kN/m, "
        f"growing by {stiffness.growth:.0f} N/m per N of tension"
    )
    friction = 2e3 * stiff.model.jaw_friction
    out.print(f"Friction may hide up to {friction:.1f} mNm against the last motion")
    out.print(f"{new.output}: the model with this stiffness")
    return Result({"model": str(new.output), **vars(stiffness)})
