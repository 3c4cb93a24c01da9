"""dVRK PSM whose joints a camera measured, step by step: a folder of .npy files.

Layout: BerkeleyAutomation/dvrkCalibration:experiment/3_training. Published with Hwang et al.,
IEEE RA-L 5(4), 2020.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from truejoint.errors import RecordingError
from truejoint.recordings.npy_file import read_npy
from truejoint.recordings.recording import Array, Provenance, Recording, state_rate
from truejoint.robots import get_robot

FILES: Final = ("t_stamp.npy", "q_des.npy", "q_act.npy")


def read(path: Path) -> Recording:
    """Read the folder of one experiment.

    Columns of the recording, for each of the arm's six joints: ``measured/<joint>`` [rad, m], the
    joint position that was commanded (the arm stood still there by its own encoders), and
    ``truth/<joint>`` [rad, m], from coloured spheres in a depth camera. About 2 rows a second.

    Raises
    ------
    RecordingError
        If a file is missing or damaged, or the files do not fit each other.
    """
    if not path.is_dir():
        raise RecordingError(
            f"{path}: is not a folder; name the folder that holds {', '.join(FILES)}"
        )
    joints = tuple(name for name in get_robot("dvrk_psm").joint_names if name != "jaw")
    arrays: dict[str, Array] = {}
    digests = []
    for name in FILES:
        arrays[name], digest = read_npy(path / name)
        digests.append(digest)
    time = arrays["t_stamp.npy"].reshape(-1)
    columns = {"t": time}
    for quantity, name in (("measured", "q_des.npy"), ("truth", "q_act.npy")):
        values = arrays[name]
        if values.shape != (time.size, len(joints)):
            raise RecordingError(
                f"{path / name}: shape {values.shape}, expected {(time.size, len(joints))} as "
                "t_stamp.npy says; are the files of one experiment?"
            )
        columns |= {f"{quantity}/{joint}": values[:, i] for i, joint in enumerate(joints)}
    provenance = Provenance(
        robot="dvrk_psm",
        source=path.name,
        sha256=digests[-1],
        session=path.name,
        rates=state_rate(time),
        notes="measured is the commanded position; sha256 is that of q_act.npy",
    )
    return Recording.from_columns(columns, provenance)
