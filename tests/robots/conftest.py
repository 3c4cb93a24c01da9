"""Fixtures of the robots' tests."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the public recordings; the test is skipped where there is none."""
    folder = Path(os.environ.get("TRUEJOINT_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip("no recordings here: set TRUEJOINT_DATA to the folder that holds them")
    return folder
