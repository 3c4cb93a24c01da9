"""Column maps of the public data sets, on files made up for the tests."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from tests.recordings.refusals import refused

from truejoint.recordings import Recording, read_recording
from truejoint.recordings.datasets import DATASETS
from truejoint.robots import get_robot

GRASPER_HEADER = (
    "%Used left spindle, 0.10 Hz Sine wave\n%idxPulse_0=0\n"
    "%Back-end Time [ms], Back-end CUI Encoder [counts], Front-end Maxon Encoder [counts]\n"
)
GRASPER_ROW = "{t},8192,1000,0.5,1000,-2000,0.25,-0.75,4096,4096\n"
DVRK = get_robot("dvrk_psm").joint_names[:6]
KUKA = {
    "time_cont": np.arange(4) * 0.004,
    "act_pos_mot_deg": np.arange(24.0).reshape(6, 4),
    "act_pos_se_deg": np.arange(24.0).reshape(6, 4) + 1,
    "act_vel_mot_deg_per_s": np.ones((6, 4)),
    "ref_pos_deg": np.zeros((6, 4)),
    "act_torque_abs_nm": np.full((6, 4), 7.0),
}
BROS = np.vstack([np.arange(9) * 1e-3, np.arange(36.0).reshape(4, 9)])
KFLEX = "0,10,0,1,5,6,100,200\n0,10,0,2,5,6,100,200\n0.025,20,0,3,7,8,300,400\n"


def read(dataset: str, path: Path) -> Recording:
    """Read a file, or a folder, by the map of a data set."""
    column_map = DATASETS[dataset].layout(path.name)["map"]
    return read_recording(path, "arrays" if path.is_dir() else None, column_map=column_map)


def write(folder: Path, name: str, content: Any) -> Path:
    """Write a text, packed where its name says so, or the variables of a MATLAB file."""
    path = folder / name
    if isinstance(content, dict):
        old = name == "part.mat"
        scipy.io.savemat(path, content, format="4" if old else "5", do_compression=not old)
    else:
        data = content.encode()
        path.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
    return path


@pytest.mark.parametrize(
    ("dataset", "name", "content", "values", "units"),
    [
        (
            "davinci_grasper_umn",
            "31.TXT",
            GRASPER_HEADER + GRASPER_ROW.format(t=0) + GRASPER_ROW.format(t=0.001),
            {
                "driver/jaw": 2 * np.pi,
                "measured/jaw": np.deg2rad(67.0 - 0.9 * 360.0),
                "setpoint/jaw": np.deg2rad(67.0 - 0.9 * 180.0),
                "motor/jaw": 2 * np.pi,
                "truth/jaw": np.pi / 2,
                "effort/jaw": 0.039811,
                "truth_effort/jaw": -0.079622,
                "current/jaw": 0.5,
                "brake/jaw": 0.25,
                "command/jaw": -0.75,
            },
            {"effort/jaw": "Nm", "truth_effort/jaw": "Nm"},
        ),
        (
            "bros_dual_encoder",
            "part.mat",
            {"data_7": BROS},
            {
                "motor/joint2": BROS[3],
                "measured/joint1": BROS[1] / 7.298,
                "measured/joint2": BROS[3] / 7.331,
                "truth/joint2": BROS[4],
            },
            {},
        ),
        (
            "kuka_kr300_dual_encoder",
            "data.mat",
            {"n_axis": 6.0, "rec": KUKA},
            {
                "measured/axis6": np.deg2rad(np.arange(20.0, 24.0)),
                "truth/axis3": np.deg2rad(np.arange(9.0, 13.0)),
                "effort/axis6": [7.0] * 4,
            },
            {"effort/axis6": "Nm"},
        ),
        (
            "kflex_tendon_sheath",
            "60.txt.gz",
            KFLEX,
            {
                "truth/bend": np.deg2rad([2.0, 3.0]),
                "measured/bend": np.deg2rad([10.0, 20.0]),
                "effort/wire2": [6.0, 8.0],
                "current/wire1": [0.1, 0.3],
            },
            {"effort/wire1": "1", "current/wire2": "A"},
        ),
        (
            "kflex_tendon_sheath",
            "conf0_60.txt",
            "0,10,0,0,0,3,5,6,7,8\n0.0005,10,0,0,0,4,5,6,7,9\n",
            {"truth/bend": np.deg2rad([3.0, 4.0]), "effort/wire4": [8.0, 9.0]},
            {},
        ),
    ],
)
def test_columns_stand_where_the_map_has_them(tmp_path, dataset, name, content, values, units):
    recording = read(dataset, write(tmp_path, name, content))
    rtol = 1e-6 if dataset.startswith("davinci") else 1e-15  # rounded efforts
    for column, expected in values.items():
        found = recording.column(column)
        np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=rtol)
    assert {column: recording.units[column] for column in units} == units
    repeated = {"repeated time stamp": 1} if content is KFLEX else {}
    assert recording.provenance.dropped == repeated
    if dataset.startswith("kuka"):
        assert recording.joints_of("truth") == ("axis1", "axis2", "axis3")
        assert len(recording.joints_of("measured")) == 6
    assert bool(recording.joints_of("current")) == any(c.startswith("current") for c in values)


@pytest.mark.parametrize(
    ("dataset", "name", "content", "said"),
    [
        (
            "davinci_grasper_umn",
            "31.TXT",
            GRASPER_HEADER + "0,1,2,3,4,5,6,7,8,9\n1,1,2,3,4,5,6,7,8\n",
            "line 5 has 9 columns, expected 10",
        ),
        (
            "kuka_kr300_dual_encoder",
            "data.mat",
            {"rec": {name: value for name, value in KUKA.items() if name != "ref_pos_deg"}},
            r"no signal 'rec.ref_pos_deg.0.'; the file has",
        ),
        (
            "bros_dual_encoder",
            "part.mat",
            {"data_1": np.zeros((4, 9)), "more": 1.0},
            "'data_1' holds 4 signals",
        ),
    ],
)
def test_a_file_that_does_not_fit_its_map_is_refused(tmp_path, dataset, name, content, said):
    refused(said, read, dataset, write(tmp_path, name, content))


def test_a_folder_of_arrays(tmp_path):
    rng = np.random.default_rng(0)
    np.save(tmp_path / "t_stamp.npy", np.arange(5) * 0.4)
    np.save(tmp_path / "q_des.npy", rng.normal(size=(5, 6)))
    np.save(tmp_path / "q_act.npy", rng.normal(size=(5, 6)))
    recording = read("dvrk_psm_berkeley", tmp_path)
    assert np.array_equal(recording.columns("measured", DVRK), np.load(tmp_path / "q_des.npy"))
    assert np.array_equal(recording.columns("truth", DVRK), np.load(tmp_path / "q_act.npy"))
    assert recording.units[f"truth/{DVRK[2]}"] == "m"
    assert recording.provenance.rates == {"state": 2.5}
    np.save(tmp_path / "q_act.npy", np.zeros((4, 6)))
    refused("'q_act' holds 4 signals", read, "dvrk_psm_berkeley", tmp_path)
    (tmp_path / "q_act.npy").unlink()
    refused("format not recognised", read_recording, tmp_path)
    refused(r"q_act.npy: there is no such file", read, "dvrk_psm_berkeley", tmp_path)
