"""A grasper's recording and the model of it, and a browser, made once."""

import pytest
from tests import chromium
from tests.synthetic import jaw_motion

from truejoint.calibration import calibrate, with_interval


@pytest.fixture(scope="session")
def jaw_model():
    model = calibrate([jaw_motion(seed, homing_id="h") for seed in range(2)], "linear")
    return with_interval(model, [jaw_motion(seed, homing_id="h") for seed in range(10, 19)])


@pytest.fixture(scope="session")
def jaw_recording():
    return jaw_motion(5, homing_id="h")


@pytest.fixture(scope="session")
def chromium_itself(tmp_path_factory):
    """A small window, for which little is drawn; all names of .example are this computer's."""
    if chromium.FOUND is None:
        pytest.skip("chromium is not installed")
    rules = "--host-resolver-rules=MAP *.example 127.0.0.1"
    folder = tmp_path_factory.mktemp("chromium")
    with chromium.Chromium(folder, 800, 300, flags=(rules,)) as browser:
        yield browser


@pytest.fixture
def browser(chromium_itself):
    """The browser that all tests share, which has said and asked for nothing yet."""
    chromium_itself.errors.clear()
    chromium_itself.requested.clear()
    yield chromium_itself
    chromium_itself.open("about:blank")
    chromium_itself.until("location.href === 'about:blank'")  # nothing is said after this test
