"""Reference data of other people's filters."""

from pathlib import Path

import pytest

from truejoint.recordings.datasets.store import data_folders


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder with inputs and outputs of other filters; skipped where there is none."""
    for folder in data_folders():
        if (folder / "filter_reference").is_dir():
            return folder / "filter_reference"
    pytest.skip("no filter_reference here: set TRUEJOINT_DATA to the folder that holds it")
