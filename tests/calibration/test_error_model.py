"""`truejoint.calibration.learn_error_model`."""

import numpy as np

import truejoint
from truejoint.recordings import Recording


def test_a_recording_that_leaves_the_arm_to_the_robot_has_that_arms_model():
    t = 0.01 * np.arange(2000)
    position = 1.0 + 0.4 * np.sin(0.5 * t)
    columns = {"t": t, "measured/elbow": position, "truth/elbow": 1.01 * position}
    recording = Recording.from_columns(columns, "raven2")
    model = truejoint.calibration.learn_error_model(recording, "linear")
    assert (model.robot, model.arm) == ("raven2_true", "left")
    np.testing.assert_allclose(model.metadata["noise"]["elbow"][0], 0.0, atol=1e-9)
