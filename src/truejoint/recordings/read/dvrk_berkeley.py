"""dVRK PSM whose joints a camera measured, step by step: a folder of .npy files.

Layout: BerkeleyAutomation/dvrkCalibration:experiment/3_training. Published with Hwang et al.,
IEEE RA-L 5(4), 2020.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from truejoint.errors import RecordingError
from truejoint.recordings.read.array_files import read_npy
from truejoint.recordings.table.recording import Recording, recordings_of_file
from truejoint.robots import get_robot

FILES: Final = ("t_stamp.npy", "q_des.npy", "q_act.npy")


def read(path: Path) -> list[Recording]:
    """Read the folder of one experiment.

    Columns, for each of the arm's six joints: ``measured/<joint>`` [rad, m], the joint position
    that was commanded (the arm stood still there by its own encoders), and ``truth/<joint>``
    [rad, m], from coloured spheres in a depth camera. About 2 rows a second.
    """
    if not path.is_dir():
        raise RecordingError(
            f"{path}: is not a folder; name the folder that holds {', '.join(FILES)}"
        )
    joints = tuple(name for name in get_robot("dvrk_psm").joint_names if name != "jaw")
    (time, _), (commanded, _), (truth, digest) = (read_npy(path / name) for name in FILES)
    columns = {"t": time.reshape(-1)}
    shape = (columns["t"].size, len(joints))
    for quantity, name, values in (
        ("measured", "q_des.npy", commanded),
        ("truth", "q_act.npy", truth),
    ):
        if values.shape != shape:
            raise RecordingError(
                f"{path / name}: shape {values.shape}, expected {shape} as t_stamp.npy says; "
                "are the files of one experiment?"
            )
        columns |= {f"{quantity}/{joint}": values[:, i] for i, joint in enumerate(joints)}
    return recordings_of_file(
        path,
        "dvrk_psm",
        columns,
        sha256=digest,
        session=path.name,
        notes="measured is the commanded position; sha256 is that of q_act.npy",
    )
