"""Whatever is done to the bytes of a file, it is read in part or refused in one line."""

import os
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (truejoint[ros])")

from .damaged import KINDS, damage, read_damaged

MINUTES = float(os.environ.get("FUZZ_MINUTES", "0"))
FIRST, COUNT = (time.time_ns() % 10**9 if MINUTES else 0), int(30 + 1000 * MINUTES)
"""Seeds of the damage."""


@pytest.fixture(scope="module", params=KINDS)
def whole(request, tmp_path_factory) -> tuple[str, bytes, dict[str, Any]]:
    """Suffix, content, and how a file of a kind is read."""
    suffix, (write, options) = request.param, KINDS[request.param]
    path = tmp_path_factory.mktemp("whole") / f"a{suffix}"
    write(path)
    return suffix, path.read_bytes(), options


def test_damage_is_survived(whole, tmp_path):
    suffix, content, options = whole
    path = tmp_path / f"b{suffix}"
    for seed in range(FIRST, FIRST + COUNT):
        data = damage(np.random.default_rng(seed), content)
        path.write_bytes(data)
        said = read_damaged(path, options)
        assert "\n" not in said, seed
        assert not said or data != content
