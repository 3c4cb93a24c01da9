"""How well seconds of a new grasper do with models of others: `calibrate_like` on public data.

    python -m benchmarks.like [--estimator rich_play] [--rate 40]

Each of the five graspers of `davinci_grasper_umn` in turn is the new one, and the other four have
models of every second recording. Of the new one, every second recording judges, which no fit saw.
Of the others the first, and those at a quarter, half and three quarters, give 20 s each; the first
three and the last three give 60 s each. Cells are means over these of the RMSE [deg].
"""

from collections.abc import Sequence

import numpy as np

from benchmarks import head, parsed, row
from truejoint.calibration import Calibration, calibrate, calibrate_like
from truejoint.evaluation.scoring import rmse
from truejoint.recordings import Recording
from truejoint.recordings.datasets import read_dataset

DATASET = "davinci_grasper_umn"
GRASPERS = ("L_Pitch_2", "L_Pitch_3", "L_Pitch_4", "L_Roll_3", "L_4")
"""Ends of the names of their folders."""


def error(model: Calibration, judging: Sequence[Recording]) -> float:
    """RMSE of the jaw [deg] over recordings."""
    errors = [model.correct(one)[:, 0] - one.table["truth/jaw"].to_numpy() for one in judging]
    return float(np.degrees(rmse(np.concatenate(errors))))


def main() -> None:
    """Print a row a grasper."""
    options = parsed(__doc__, estimator="rich_play", rate=40.0)
    how = {"fit_rate": options.rate}
    learning, judging = dict[str, list[Recording]](), dict[str, list[Recording]]()
    for name in GRASPERS:
        recordings = read_dataset(DATASET, f"Tool_4_Maryland_{name}/*")
        learning[name], judging[name] = recordings[::2], recordings[1::2]
    models = {name: calibrate(own, options.estimator, **how) for name, own in learning.items()}
    head(
        "grasper", "20 s alone", "20 s like four", "60 s alone", "60 s like four", "all of its own"
    )
    for name, own in learning.items():
        others = [model for other, model in models.items() if other != name]
        places = [len(own) * quarter // 4 for quarter in range(4)]
        cells = list[float]()
        for few in ([own[place : place + 1] for place in places], [own[:3], own[-3:]]):
            alone = [calibrate(some, options.estimator, **how) for some in few]
            like = [calibrate_like(some, others, options.estimator, **how) for some in few]
            for fits in (alone, like):
                cells.append(float(np.mean([error(fit, judging[name]) for fit in fits])))
        cells.append(error(models[name], judging[name]))
        row(f"`{name}`", *(f"{cell:.2f}" for cell in cells))


if __name__ == "__main__":
    main()
