"""A grasper's recording and the model of it, and a browser, made once."""

import numpy as np
import pytest
from tests import chromium

from truejoint.calibration import calibrate, with_interval
from truejoint.recordings import Provenance, Recording


def motion(seed, **about):
    """Four seconds of a jaw that is 2 % and 0.01 rad off."""
    rng = np.random.default_rng(seed)
    t = np.arange(400) / 100
    jaw = 0.5 + 0.3 * np.sin(2 * t + rng.uniform(0, 6)) * np.sin(5 * t)
    effort = 0.02 * np.cos(3 * t + rng.uniform(0, 6)) + 1e-3 * rng.standard_normal(400)
    truth = 1.02 * jaw + 0.01 + 1e-4 * rng.standard_normal(400)
    columns = {"t": t, "measured/jaw": jaw, "effort/jaw": effort, "truth/jaw": truth}
    about = {"homing_id": "h", "session": str(seed), **about}
    return Recording.from_columns(columns, Provenance("davinci_grasper", **about))


@pytest.fixture(scope="session")
def jaw_model():
    model = calibrate([motion(0), motion(1)], "linear")
    return with_interval(model, [motion(seed) for seed in range(10, 19)])


@pytest.fixture(scope="session")
def jaw_recording():
    return motion(5)


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
