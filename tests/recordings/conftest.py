"""Files of every layout, made up for the tests."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from truejoint.crtk.messages import PROFILES
from truejoint.recordings import Provenance, Recording


@pytest.fixture
def recording() -> Recording:
    """A small recording of two joints with a stretch without truth."""
    t = np.arange(50) * 0.01 + 0.003
    truth = np.cos(t)
    truth[20:30] = np.nan
    columns = {
        "t": t,
        "measured/joint1": np.sin(t),
        "measured/joint2": np.cos(3 * t),
        "motor/joint1": 7.3 * np.sin(t),
        "truth/joint1": truth,
    }
    provenance = Provenance(
        robot="bros",
        source="bench",
        session="a",
        load=0.25,
        rates={"state": 100.0},
        dropped={"x": 3},
    )
    return Recording.from_columns(columns, provenance)


@pytest.fixture
def write_raven(tmp_path: Path) -> Callable[..., Path]:
    """Writes a RAVEN file of `columns` columns: every value tells where it stands."""

    def write(
        columns: int, rows: int = 40, name: str = "state.csv", change: Callable | None = None
    ) -> Path:
        table = np.arange(rows)[:, None] * 1e-3 + np.arange(columns)[None, :]
        start = 12 if columns >= 252 else 0
        table[:, start] = 1.7e9 + np.arange(rows) / 30.0
        table[:, start + 17] = 3
        if columns >= 252:
            # The sensor agrees with the joint but for a constant.
            offsets = PROFILES["raven2"].truth_offsets
            zero = [offsets.get(joint, 0.0) for joint in ("shoulder", "elbow", "insertion")]
            table[:, 1:4] = np.add(
                np.deg2rad(table[:, start + 1 : start + 4]), np.subtract([0.01, -0.02, 0.003], zero)
            )
        if change is not None:
            change(table)
        path = tmp_path / name
        np.savetxt(path, table, delimiter=",", fmt="%.12e")
        return path

    return write
