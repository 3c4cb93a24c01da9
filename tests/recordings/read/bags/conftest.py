"""A session on the simulated RAVEN-II, and bags of it."""

from pathlib import Path

import numpy as np
import pytest

from truejoint.recordings import Provenance, Recording, write_bag
from truejoint.robots import get_robot

pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")


def make_session(rows: int = 300, start: float = 1.7e9) -> Recording:
    """Every channel's every quantity moves in a way of its own."""
    robot = get_robot("raven2", "left")
    t = np.arange(rows) * 0.01
    columns = {"t": t}
    for k, channel in enumerate(robot.channels):
        swing = np.sin((1.0 + 0.3 * k) * t)
        columns |= {
            f"measured/{channel}": 0.5 + 0.05 * swing,
            f"velocity/{channel}": 0.05 * (1.0 + 0.3 * k) * np.cos((1.0 + 0.3 * k) * t),
            f"effort/{channel}": 0.1 * np.cos(k + t),
            f"setpoint/{channel}": 0.5 + 0.051 * swing,
        }
    for k, joint in enumerate(robot.positioning):
        columns[f"truth/{joint}"] = columns[f"measured/{joint}"] + 0.01 * np.cos(t + k)
    return Recording.from_columns(columns, Provenance("raven2", "left", start=start))


@pytest.fixture(scope="session")
def session() -> Recording:
    return make_session()


@pytest.fixture(scope="session")
def bag(session: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "session.bag"
    write_bag(session, path)
    return path
