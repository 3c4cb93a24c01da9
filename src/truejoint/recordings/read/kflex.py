"""K-FLEX bending joint pulled through a tendon sheath.

Layout: nhoyh/hysteresis_compensation_ROS:optimization/selected. Two kinds of file: 8 columns at
40 Hz with two wires, and 10 columns at about 2 kHz with four wires and an electromagnetic tracker.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from truejoint.errors import RecordingError
from truejoint.recordings.read.numeric_text import TextLayout, count_fields, read_numbers
from truejoint.recordings.table.recording import Recording, recordings_of_file

# By the number of columns: time, commanded angle, truth, tension of each wire, current of each
# motor; and the rate [Hz].
LAYOUTS: Final = {8: ((0, 1, 3, 4, 5, 6, 7), 40.0), 10: ((0, 1, 5, 6, 7, 8, 9), 2000.0)}


def read(path: Path) -> list[Recording]:
    """Read one file, text or gzip, of either layout.

    Columns: ``measured/bend`` [rad], the commanded angle; ``truth/bend`` [rad], the angle at the
    far end; ``effort/wire<k>``, wire tension in undocumented units; in the 8-column layout
    ``current/wire<k>`` [A]. The commanded velocity and the camera's estimates are left out: the
    first is mis-scaled, the others were switched off.

    The recorder wrote rows more than once while its clock stood: the last one of each time stamp
    is kept, the others are counted.
    """
    count = count_fields(path)
    if count not in LAYOUTS:
        raise RecordingError(f"{path}: {count} columns, expected 8 or 10; is it a K-FLEX file?")
    use, rate = LAYOUTS[count]
    table = read_numbers(path, TextLayout(count), use)
    time, commanded, truth, *wires = table.values.T
    columns = {"t": time, "measured/bend": np.radians(commanded), "truth/bend": np.radians(truth)}
    currents = wires[2:] if count == 8 else []  # mA in the file
    tensions = wires[: len(wires) - len(currents)]
    columns |= {f"effort/wire{k}": tension for k, tension in enumerate(tensions, 1)}
    columns |= {f"current/wire{k}": current * 1e-3 for k, current in enumerate(currents, 1)}
    return recordings_of_file(
        path,
        "kflex",
        columns,
        rate=rate,
        sha256=table.sha256,
        dropped={"last line cut short": table.incomplete},
        notes="measured is the commanded angle; wire tensions are in undocumented units",
    )
