"""The filter on recordings of a real jaw, where they are at hand."""

import numpy as np
import pytest

from truejoint import calibrate
from truejoint.errors import RecordingError
from truejoint.recordings.datasets import locate, read_dataset


@pytest.fixture(scope="module")
def folder():
    try:
        return locate("davinci_grasper_umn")
    except RecordingError as error:
        pytest.skip(str(error))


def test_a_load_that_it_never_saw(folder):
    training = read_dataset("davinci_grasper_umn", "Tool_4_Maryland_L_4/1[048]")
    unseen = read_dataset("davinci_grasper_umn", "Tool_4_Maryland_L_4/15")[0]
    calibration = calibrate(training, "ukf_elastic", fit_rate=20.0)
    error = calibration.correct(unseen) - unseen.columns("truth", ("jaw",))
    rmse = np.degrees(np.sqrt(np.mean(error**2)))
    offset = calibration.baselines["offset"].correct(unseen) - unseen.columns("truth", ("jaw",))
    assert rmse < 0.4
    assert rmse < 0.25 * np.degrees(np.sqrt(np.mean(offset**2)))
