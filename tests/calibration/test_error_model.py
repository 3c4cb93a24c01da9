"""`truejoint.calibration.learn_error_model`."""

import numpy as np
import pytest
from tests.refusals import refused

import truejoint
from truejoint.errors import CalibrationError
from truejoint.recordings import Recording
from truejoint.runtime import ErrorModel


def test_a_recording_that_leaves_the_arm_to_the_robot_has_that_arms_model():
    t = 0.01 * np.arange(2000)
    position = 1.0 + 0.4 * np.sin(0.5 * t)
    columns = {"t": t, "measured/elbow": position, "truth/elbow": 1.01 * position}
    recording = Recording.from_columns(columns, "raven2")
    model = truejoint.calibration.learn_error_model(recording, "linear")
    assert (model.robot, model.arm) == ("raven2_true", "left")
    for noise in (5, {}, {"elbow": [1.0]}, {"elbow": ["a", 1.0]}, {"elbow": [-1e-3, 1.0]},
                  {"elbow": [1e-3, 0.0]}):  # fmt: skip
        refused("want a size of at least 0", ErrorModel, model.with_metadata(noise=noise))
    np.testing.assert_allclose(model.metadata["noise"]["elbow"][0], 0.0, atol=1e-9)


def test_one_joint_alone_is_learnt_by_plays_that_are_not_coupled():
    t = 0.02 * np.arange(1500)
    position = 0.4 * np.sin(0.5 * t) + 0.3 * np.sin(1.3 * t)
    columns = {"t": t, "measured/jaw": position, "truth/jaw": 0.98 * position + 0.01}
    recording = Recording.from_columns(columns, "davinci_grasper")
    assert truejoint.calibration.learn_error_model(recording).estimator == "rich_play"
    with pytest.raises(CalibrationError, match="2 to 12 measured positions by their places"):
        truejoint.calibrate(recording, "coupled_play")
