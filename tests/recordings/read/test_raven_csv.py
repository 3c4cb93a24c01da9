import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.recordings.refusals import refused

from truejoint.recordings import read_recording
from truejoint.recordings.read.raven_csv import frozen_rows

WriteRaven = Callable[..., Path]

# From the layout's description, written down here a second time: first column of a quantity in
# the 240-column file, and whether degrees stand there.
BLOCKS = {
    "measured": (1, True),
    "effort": (102, False),
    "motor": (118, True),
    "motor_velocity": (134, True),
    "velocity": (150, True),
    "setpoint": (182, True),
    "motor_setpoint": (166, True),
    "encoder": (70, False),
    "encoder_offset": (200, False),
    "dac": (86, False),
}
# The same of what each arm has once: first column, how many of them, whether in micrometres.
OF_ARM = {
    "tool": (22, 3, True),
    "rotation": (28, 9, False),
    "rotation_setpoint": (46, 9, False),
    "tool_setpoint": (64, 3, True),
    "grasp_setpoint": (198, 1, False),
    "jacobian_velocity": (216, 6, False),
    "jacobian_force": (228, 6, False),
}
CHANNELS = ("shoulder", "elbow", "insertion", "unused", "roll", "wrist", "jaw1", "jaw2")


@pytest.mark.parametrize(("arm", "offset"), [("left", 0), ("gold", 0), ("right", 8), ("green", 8)])
@pytest.mark.parametrize("columns", [240, 252, 256])
def test_every_column_is_where_the_layout_has_it(write_raven, arm, offset, columns):
    def agree(table: np.ndarray) -> None:
        if columns >= 252:
            table[:, 1:4] = np.deg2rad(table[:, 13 + offset : 16 + offset])

    path = write_raven(columns, change=agree)
    table = np.loadtxt(path, delimiter=",")
    recording = read_recording(path, arm=arm)
    assert recording.provenance.arm == ("left" if offset == 0 else "right")
    start = 12 if columns >= 252 else 0
    for quantity, (first, degrees) in BLOCKS.items():
        for i, channel in enumerate(CHANNELS):
            expected = table[:, start + first + offset + i]
            # One factor for all, the insertion's metres too.
            expected = np.deg2rad(expected) if degrees else expected
            assert np.allclose(recording.column(f"{quantity}/{channel}"), expected, atol=1e-12)
    for quantity, (first, count, micrometres) in OF_ARM.items():
        where = start + first + (count if offset else 0)
        expected = table[:, where : where + count] * (1e-6 if micrometres else 1.0)
        found = recording.columns(quantity, recording.joints_of(quantity))
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert recording.units["tool/x"] == recording.units["tool_setpoint/z"] == "m"
    assert recording.column("state/last_seq")[0] == table[0, start + 19]
    assert recording.joints_of("crtk") == (recording.robot.joint_names if columns >= 252 else ())
    if columns >= 252:
        assert recording.column("crtk/shoulder")[0] == table[0, 5]
        assert recording.units["crtk/insertion"] == "m"
    assert recording.t[0] == 0.0
    assert recording.duration == pytest.approx(39 / 30, abs=1e-5)
    assert recording.provenance.start == 1.7e9
    assert recording.units["measured/insertion"] == "m"
    assert recording.units["effort/insertion"] == "Nm"
    assert recording.joints_of("truth") == (CHANNELS[:3] if columns >= 252 else ())


def test_the_truth_is_in_rad_and_m(write_raven):
    error = read_recording(write_raven(252)).error(("shoulder", "elbow", "insertion"))
    assert np.allclose(error, [0.01, -0.02, 0.003])


def test_the_truth_of_a_file_and_of_the_bag_it_was_made_of_have_one_zero(write_raven):
    # The driver's zero is 7.5 deg and 10.5 mm from the robot's: raven2_CRTK_Python_controller:
    # joint_encoder/func_raven_joint_encodersIII.py has 130 deg and 0.572467 m at the hard stops,
    # raven2:src/raven 137.5 deg and 0.562 m.
    path = write_raven(252)
    shifted, own = (read_recording(path, truth_zero=zero) for zero in ("encoders", "robot"))
    joints = ("shoulder", "elbow", "insertion")
    added = shifted.columns("truth", joints) - own.columns("truth", joints)
    np.testing.assert_allclose(added, np.tile([0.0, np.deg2rad(7.5), -0.010467], (40, 1)))
    assert "added to the truth [rad or m]: +0.1309 to elbow" in shifted.provenance.notes
    assert own.provenance.notes == ""
    refused(
        "no truth zero called 'home'; known: encoders, robot",
        read_recording,
        path,
        truth_zero="home",
    )


def test_truth_in_a_unit_that_cannot_be_is_refused(write_raven):
    def working_range(table: np.ndarray) -> None:
        table[:, 13:16] = [40.0, 80.0, np.rad2deg(0.4)]
        table[:, 1:4] = [41.0, 79.0, 0.41]

    path = write_raven(252, change=working_range)
    refused(r"truth of shoulder .* check units and arm", read_recording, path)


def test_truth_that_stops_is_taken_out_and_counted(write_raven):
    def stop(table: np.ndarray) -> None:
        travel = np.linspace(0.0, 20.0, len(table))
        table[:, 13] = 30.0 + travel
        table[:, 1] = np.deg2rad(30.0 + np.minimum(travel, 8.0))
        table[:, 2:4] = table[0, 2:4]

    recording = read_recording(write_raven(252, rows=120, change=stop))
    truth = recording.column("truth/shoulder")
    lost = np.isnan(truth)
    assert 60 < lost.sum() < 80
    assert lost[-1]
    assert not lost[:40].any()
    assert recording.provenance.dropped == {"no truth: its sensor stands still": lost.sum()}


def test_a_joint_that_really_stands_still_is_not_frozen():
    t = np.arange(300) * 0.03
    truth = np.zeros((300, 3))
    assert not frozen_rows(t, truth, np.zeros((300, 3))).any()
    # Within the slack of a cable the motor turns and the joint does not.
    slack = np.zeros((300, 3))
    slack[:, 0] = np.deg2rad(2.0) * np.sin(t)
    assert not frozen_rows(t, truth, slack).any()


def test_rows_of_the_homing_are_left_out_and_counted(write_raven):
    def homing(table: np.ndarray) -> None:
        table[:15, 17] = 1

    recording = read_recording(write_raven(240, change=homing))
    assert len(recording) == 25
    assert recording.provenance.dropped == {"homing": 15}


@pytest.mark.parametrize("found", [239, 241, 255])
def test_another_column_count_is_named(write_raven, found):
    path = write_raven(found)
    text = refused(f"{found} columns, expected 240 or 252", read_recording, path, "raven_csv")
    assert "column map" in text
    assert str(path) in text


def test_a_file_without_truth_takes_nothing_of_it(write_raven):
    refused(
        "has no truth; leave truth_zero out", read_recording, write_raven(240), truth_zero="robot"
    )


def test_missing_numbers(write_raven):
    def hole(table: np.ndarray) -> None:
        table[7, 1] = np.nan

    recording = read_recording(write_raven(240, change=hole))
    assert recording.provenance.dropped == {"value missing": 1}
    assert len(recording) == 39
    # In the truth it is a reading that is missing.
    recording = read_recording(write_raven(252, change=hole))
    assert recording.provenance.dropped == {"truth: value missing": 1}
    assert np.isnan(recording.column("truth/shoulder")[7])


def test_a_file_in_gzip_and_one_cut_short(write_raven, tmp_path):
    path = write_raven(240)
    whole = read_recording(path)
    packed = tmp_path / "state.csv.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert read_recording(packed).table.equals(whole.table)
    assert read_recording(packed).provenance.sha256 == whole.provenance.sha256
    path.write_bytes(path.read_bytes()[:-1000])
    cut = read_recording(path)
    assert len(cut) == 39
    assert cut.provenance.dropped == {"last line cut short": 1}
