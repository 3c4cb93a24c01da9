"""K-FLEX bending joint pulled through a tendon sheath.

Layout: nhoyh/hysteresis_compensation_ROS:optimization/selected. Two kinds of file: 8 columns at
40 Hz with two wires, and 10 columns at about 2 kHz with four wires and an electromagnetic tracker.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from truejoint.errors import RecordingError
from truejoint.recordings.numeric_text import (
    TextLayout,
    first_line,
    read_numbers,
    split_fields,
)
from truejoint.recordings.recording import Provenance, Recording, last_of_each_stamp

# Time, commanded angle, truth, tension of each wire, current of each motor.
_TWO_WIRES: Final = (0, 1, 3, 4, 5, 6, 7)
_FOUR_WIRES: Final = (0, 1, 5, 6, 7, 8, 9)
LAYOUTS: Final = {8: _TWO_WIRES, 10: _FOUR_WIRES}


def read(path: Path) -> Recording:
    """Read one file, text or gzip, of either layout.

    Columns of the recording: ``measured/bend`` [rad], the commanded angle; ``truth/bend`` [rad],
    the angle at the far end; ``effort/wire<k>``, wire tension in undocumented units; in the
    8-column layout ``current/wire<k>`` [A]. The commanded velocity and the camera's estimates
    are left out: the first is mis-scaled, the others were switched off.

    The recorder wrote rows more than once while its clock stood: the last one of each time stamp
    is kept, the others are counted.

    Raises
    ------
    RecordingError
        Naming file, line and what is wrong with it.
    """
    count = len(split_fields(first_line(path)[1], ","))
    if count not in LAYOUTS:
        raise RecordingError(f"{path}: {count} columns, expected 8 or 10; is it a K-FLEX file?")
    table = read_numbers(path, TextLayout(count), LAYOUTS[count])
    last = last_of_each_stamp(table.values[:, 0])
    time, commanded, truth, *others = table.values[last].T
    columns = {"t": time, "measured/bend": np.radians(commanded), "truth/bend": np.radians(truth)}
    if count == 8:
        columns |= {f"effort/wire{k + 1}": others[k] for k in range(2)}
        # mA in the file
        columns |= {f"current/wire{k + 1}": others[2 + k] * 1e-3 for k in range(2)}
    else:
        columns |= {f"effort/wire{k + 1}": others[k] for k in range(4)}
    dropped = {"repeated time stamp": int((~last).sum()), "last line cut short": table.incomplete}
    session = path.name.split(".", maxsplit=1)[0]
    rate = 40.0 if count == 8 else 2000.0
    provenance = Provenance(
        robot="kflex",
        source=path.name,
        sha256=table.sha256,
        session=session,
        rates={"state": rate, "truth": rate},
        dropped=dropped,
        notes="measured is the commanded angle; wire tensions are in undocumented units",
    )
    return Recording.from_columns(columns, provenance)
