"""Readers of the public data sets, on files made up for the tests and on the data itself."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from truejoint.errors import RecordingError
from truejoint.recordings import Recording, read_recording
from truejoint.recordings.datasets import DATASETS, read_dataset
from truejoint.robots import get_robot

GRASPER_HEADER = (
    "%Used left spindle, 0.10 Hz Sine wave\n%idxPulse_0=0\n"
    "%Back-end Time [ms], Back-end CUI Encoder [counts], Front-end Maxon Encoder [counts]\n"
)
FindFolder = Callable[[str], Path]


def read(dataset: str, path: Path) -> Recording:
    """Read a file, or a folder, by the map of a data set."""
    column_map = DATASETS[dataset].layout(path.name)["map"]
    return read_recording(path, "arrays" if path.is_dir() else None, column_map=column_map)


def grasper_file(folder: Path, rows: list[str]) -> Path:
    path = folder / "31.TXT"
    path.write_text(GRASPER_HEADER + "\n".join(rows) + "\n")
    return path


def test_grasper_scales(tmp_path):
    row = "{t},8192,1000,0.5,1000,-2000,0.25,-0.75,4096,4096"
    path = grasper_file(tmp_path, [row.format(t=0), row.format(t=0.001)])
    recording = read("davinci_grasper_umn", path)
    value = {name: recording.column(name)[0] for name in recording.table.columns}
    assert value["driver/jaw"] == pytest.approx(2 * np.pi)
    assert value["measured/jaw"] == pytest.approx(np.deg2rad(67.0 - 0.9 * 360.0))
    assert value["setpoint/jaw"] == pytest.approx(np.deg2rad(67.0 - 0.9 * 180.0))
    assert value["motor/jaw"] == pytest.approx(2 * np.pi)
    assert value["truth/jaw"] == pytest.approx(np.pi / 2)
    assert value["effort/jaw"] == pytest.approx(0.039811)
    assert value["truth_effort/jaw"] == pytest.approx(-0.079622)
    assert (value["current/jaw"], value["brake/jaw"], value["command/jaw"]) == (0.5, 0.25, -0.75)
    assert recording.units["effort/jaw"] == recording.units["truth_effort/jaw"] == "Nm"


def test_grasper_file_with_another_column_count(tmp_path):
    path = grasper_file(tmp_path, ["0,1,2,3,4,5,6,7,8,9", "1,1,2,3,4,5,6,7,8"])
    with pytest.raises(RecordingError, match="line 5 has 9 columns, expected 10"):
        read("davinci_grasper_umn", path)


def test_grasper_data(dataset_folder):
    dataset_folder("davinci_grasper_umn")
    for recording in read_dataset("davinci_grasper_umn", "Tool_4_Maryland_L_4/[03]5"):
        assert 19900 < len(recording) < 20010
        assert np.allclose(np.diff(recording.t), 1e-3, atol=1e-9)
        assert "times a nominal ratio" in recording.provenance.notes
        # A fixed offset leaves 1-2 deg in each file; the nominal zero is off by a few more.
        error = np.rad2deg(recording.error(["jaw"])[:, 0])
        assert 0.8 < error.std() < 2.0
        assert abs(error.mean()) < 6.0
        # The motor turns against the spindle, 35 times as fast, and ropes stretch between.
        slope = np.polyfit(recording.column("driver/jaw"), recording.column("motor/jaw"), 1)[0]
        assert slope == pytest.approx(-35.0, rel=0.03)


def dvrk_folder(folder: Path, rows: int = 5) -> Path:
    rng = np.random.default_rng(0)
    np.save(folder / "t_stamp.npy", np.arange(rows) * 0.4)
    np.save(folder / "q_des.npy", rng.normal(size=(rows, 6)))
    np.save(folder / "q_act.npy", rng.normal(size=(rows, 6)))
    return folder


def test_dvrk_folder(tmp_path):
    recording = read("dvrk_psm_berkeley", dvrk_folder(tmp_path))
    joints = get_robot("dvrk_psm").joint_names[:6]
    assert np.array_equal(recording.columns("measured", joints), np.load(tmp_path / "q_des.npy"))
    assert np.array_equal(recording.columns("truth", joints), np.load(tmp_path / "q_act.npy"))
    assert recording.units[f"truth/{joints[2]}"] == "m"
    assert recording.provenance.rates == {"state": 2.5}


def test_dvrk_files_that_do_not_fit(tmp_path):
    dvrk_folder(tmp_path)
    np.save(tmp_path / "q_act.npy", np.zeros((4, 6)))
    with pytest.raises(RecordingError, match="'q_act' holds 4 signals"):
        read("dvrk_psm_berkeley", tmp_path)
    (tmp_path / "q_act.npy").unlink()
    with pytest.raises(RecordingError, match="format not recognised"):
        read_recording(tmp_path)
    with pytest.raises(RecordingError, match=r"q_act.npy: there is no such file"):
        read("dvrk_psm_berkeley", tmp_path)


def test_dvrk_data(dataset_folder):
    dataset_folder("dvrk_psm_berkeley")
    random, _ = read_dataset("dvrk_psm_berkeley")
    assert len(random) == 5531
    spread = random.error(get_robot("dvrk_psm").joint_names[:6]).std(axis=0)
    # The first two joints and the insertion are good, the wrist is off by ten degrees.
    assert (spread[:2] < np.deg2rad(0.2)).all()
    assert spread[2] < 1e-3
    assert (spread[4:] > np.deg2rad(8.0)).all()


def test_bros_file(tmp_path):
    data = np.vstack([np.arange(9) * 1e-3, np.arange(36.0).reshape(4, 9)])
    path = tmp_path / "part.mat"
    scipy.io.savemat(path, {"data_7": data}, format="4")
    recording = read("bros_dual_encoder", path)
    assert np.array_equal(recording.column("motor/joint2"), data[3])
    assert recording.column("measured/joint1") == pytest.approx(data[1] / 7.298)
    assert recording.column("measured/joint2") == pytest.approx(data[3] / 7.331)
    assert np.array_equal(recording.column("truth/joint2"), data[4])


def test_bros_data(dataset_folder):
    dataset_folder("bros_dual_encoder")
    for recording in read_dataset("bros_dual_encoder"):
        # The ratio is right: what is left of the motor angle in the error is cable, 0.2 deg.
        assert (np.rad2deg(recording.error(("joint1", "joint2")).std(axis=0)) < 0.3).all()


def kuka_file(path: Path, **changed: object) -> Path:
    rec = {
        "time_cont": np.arange(4) * 0.004,
        "act_pos_mot_deg": np.arange(24.0).reshape(6, 4),
        "act_pos_se_deg": np.arange(24.0).reshape(6, 4) + 1,
        "act_vel_mot_deg_per_s": np.ones((6, 4)),
        "ref_pos_deg": np.zeros((6, 4)),
        "act_torque_abs_nm": np.full((6, 4), 7.0),
    } | changed
    kept = {name: value for name, value in rec.items() if value is not None}
    scipy.io.savemat(path, {"n_axis": 6.0, "rec": kept}, do_compression=True)
    return path


def test_kuka_file(tmp_path):
    recording = read("kuka_kr300_dual_encoder", kuka_file(tmp_path / "data.mat"))
    assert recording.joints_of("truth") == ("axis1", "axis2", "axis3")
    assert len(recording.joints_of("measured")) == 6
    assert np.rad2deg(recording.error(["axis2"])) == pytest.approx(1.0)
    assert recording.column("effort/axis6").tolist() == [7.0] * 4
    assert recording.units["effort/axis6"] == "Nm"


def test_a_signal_that_a_file_lacks_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r"no signal 'rec.ref_pos_deg.0.'; the file has"):
        read("kuka_kr300_dual_encoder", kuka_file(tmp_path / "data.mat", ref_pos_deg=None))
    path = tmp_path / "part.mat"
    scipy.io.savemat(path, {"data_1": np.zeros((4, 9)), "more": 1.0}, format="4")
    with pytest.raises(RecordingError, match="'data_1' holds 4 signals"):
        read("bros_dual_encoder", path)


def test_kuka_data(dataset_folder):
    dataset_folder("kuka_kr300_dual_encoder")
    for recording in read_dataset("kuka_kr300_dual_encoder"):
        assert len(recording) == 2501
        assert recording.provenance.homing_id == recording.provenance.session
        error = np.rad2deg(recording.error(("axis1", "axis2", "axis3")))
        assert (error.std(axis=0) < 0.05).all()
        assert (np.abs(error.mean(axis=0)) < 0.2).all()


def test_kflex_keeps_the_last_row_of_each_stamp(tmp_path):
    path = tmp_path / "60.txt.gz"
    rows = ["0,10,0,1,5,6,100,200", "0,10,0,2,5,6,100,200", "0.025,20,0,3,7,8,300,400"]
    path.write_bytes(gzip.compress("\n".join(rows).encode()))
    recording = read("kflex_tendon_sheath", path)
    assert recording.provenance.dropped == {"repeated time stamp": 1}
    assert np.rad2deg(recording.column("truth/bend")) == pytest.approx([2.0, 3.0])
    assert np.rad2deg(recording.column("measured/bend")) == pytest.approx([10.0, 20.0])
    assert recording.column("effort/wire2").tolist() == [6.0, 8.0]
    assert recording.column("current/wire1") == pytest.approx([0.1, 0.3])
    assert recording.units["effort/wire1"] == "1"
    assert recording.units["current/wire2"] == "A"


def test_kflex_four_wires(tmp_path):
    path = tmp_path / "conf0_60.txt"
    path.write_text("0,10,0,0,0,3,5,6,7,8\n0.0005,10,0,0,0,4,5,6,7,9\n")
    recording = read("kflex_tendon_sheath", path)
    assert np.rad2deg(recording.column("truth/bend")) == pytest.approx([3.0, 4.0])
    assert recording.column("effort/wire4").tolist() == [8.0, 9.0]
    assert recording.joints_of("current") == ()


def test_kflex_data(dataset_folder):
    dataset_folder("kflex_tendon_sheath")
    recordings = {r.provenance.session: r for r in read_dataset("kflex_tendon_sheath")}
    assert recordings["conf0_60"].provenance.dropped == {"repeated time stamp": 7041}
    # The more the sheath bends, the less of the motion arrives.
    travel = [np.ptp(recordings[a].column("truth/bend")) for a in ("0", "60", "120", "180", "240")]
    assert (np.diff(travel) < 0).all()
