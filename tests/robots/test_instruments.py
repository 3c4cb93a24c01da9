"""Numbers of the single-instrument robots that have any."""

import numpy as np
import pytest
from scipy.io import loadmat

from truejoint.recordings import read_column_map
from truejoint.recordings.datasets import DATASETS
from truejoint.robots import get_robot


@pytest.mark.parametrize(("part", "variable"), [("part1", "data_1"), ("part2", "data_2")])
def test_bros_ratios_are_those_of_its_encoders(dataset_folder, part, variable):
    rows = loadmat(dataset_folder("bros_dual_encoder") / f"transmission_data_{part}.mat")[variable]
    transmission = get_robot("bros").transmission
    joint = transmission.joint_from_motor(rows[[1, 3]].T)
    for column, truth in zip(joint.T, rows[[2, 4]], strict=True):
        slope = np.polyfit(truth, column, 1)[0]
        assert slope == pytest.approx(1.0, abs=1e-3)


def test_grasper_driver_and_motor_count_the_same_spindle():
    # 4096 motor counts at 35:1 against 8192 driver counts for the same turn.
    columns = read_column_map(DATASETS["davinci_grasper_umn"].layouts[0]["map"]).columns
    spindle = columns["motor/jaw"].scale / 35
    assert columns["driver/jaw"].scale / spindle == pytest.approx(17.5)
