"""What another package can add to truejoint: a robot by a file, a file format, an estimator."""

from pathlib import Path

import numpy as np
from sklearn.linear_model import Ridge

from truejoint.errors import RecordingError
from truejoint.recordings import Format, Provenance, Recording

ROBOT = Path(__file__).with_name("lever.toml")


def read_counts(path: Path) -> Recording:
    """Read lines of time [ms], motor counts (4096 a turn, 50:1) and lever counts (8192 a turn)."""
    try:
        time, motor, lever = np.loadtxt(path, ndmin=2, unpack=True)
    except ValueError as error:
        raise RecordingError(f"{path}: is no file of three counts a line ({error})") from None
    columns = {
        "t": time * 1e-3,
        "measured/lever": motor * (2 * np.pi / 4096 / 50),
        "truth/lever": lever * (2 * np.pi / 8192),
    }
    return Recording.from_columns(columns, Provenance("example_lever", source=path.name))


COUNTS = Format("example_counts", "counts of the example lever", read_counts)


class ExampleRidge(Ridge):  # type: ignore[misc]  # sklearn: untyped
    """Linear regression that shrinks; linear, so that it runs in the loop and in C as it is."""

    def __init__(self, alpha: float = 1e-3) -> None:
        super().__init__(alpha)
