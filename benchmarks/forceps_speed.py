"""How long 70 s of the virtual forceps take on one core.

Run: ``python benchmarks/forceps_speed.py``
"""

import statistics
import time

import numpy as np

from truejoint.motion.forceps_trajectories import verification_trajectory
from truejoint.simulation.forceps.specimens import SPECIMENS, population, specimen
from truejoint.simulation.forceps.twin import simulate_forceps

DURATION = 70.0
REPEATS = 5


def main() -> None:
    """Print the median over a few runs of each specimen and of one with the second friction."""
    setpoint = verification_trajectory(DURATION - 2.0).positions[:, 0]
    simulate_forceps(specimen(), np.zeros(10))
    (other,) = population(1, prior="capstan")
    for name, parameters in [*((name, specimen(name)) for name in SPECIMENS), ("capstan", other)]:
        taken = []
        for _ in range(REPEATS):
            start = time.process_time()  # other programs on the machine do not count
            simulate_forceps(parameters, setpoint)
            taken.append(time.process_time() - start)
        median = statistics.median(taken)
        step = 1e6 * median / (DURATION * 1e4)
        print(
            f"{name:8s} {DURATION:.0f} s of plant in {median:.3f} s of one core "
            f"({DURATION / median:.0f} x real time, {step:.2f} us a step)"
        )


if __name__ == "__main__":
    main()
