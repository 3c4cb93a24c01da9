"""The measured Maryland grasper over wrist posture: coupling, friction, and a calibration's reach.

    python -m benchmarks.wrist_tool [--part identified|held-out ...]

identified  Coupling of the jaw to its disc and to the pitch, stretch and capstan friction of its
            cables, from MRDLab/mis-tool-characterization, folders Tool_4_Maryland_L_Pitch_2, 3, 4:
            the wrist's pitch held by hand at +30, 0, -30 deg, 16 files each.
held-out    Calibrated at pitch 0, judged at the other postures, the jaw's position being that of
            the coupling at the pitch that the protractor showed. The zero of the jaw differs by
            2-3 deg from file to file, so that either one offset of each file is taken off, or the
            first 2 s of its truth set the zero.

Prints Markdown tables. Angles in deg.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from truejoint import calibrate
from truejoint.calibration import Calibration
from truejoint.calibration.origin import ZeroOf
from truejoint.calibration.zero import find_zero, zeroed
from truejoint.estimators import Plays
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, read_dataset
from truejoint.robots import get_robot

Array = NDArray[np.float64]

TOOL = "420172"
PITCH = {2: 30.0, 3: 0.0, 4: -30.0}  # [deg] by protractor, to 2-3 deg
FIT_RATE = 40.0
REZERO = 2.0
"""Time at the start of a file whose truth sets the zero [s]."""
SLIDING = 0.15
"""Speed of the jaw [rad/s] above which its cables slide everywhere."""
MIDDLE = 0.5
"""Share of a stroke, about its middle, whose rows count: what loads the jaw has settled there."""
DRAWS = 400
BY_HAND = 2.5
"""Standard deviation of a pitch that was set by protractor [deg]."""
RULE = "ridge on plays, motor too"
"""At one posture nothing tells apart what goes with the jaw from what goes with its motor: a model
for other postures is given both, and a ridge shares between them what either would explain."""
PLAYS = Plays(plays=(0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5), time_constants=(0.05, 0.5))
METHODS: dict[str, tuple[str | Plays, list[str], ZeroOf]] = {
    "linear": ("linear", ["measured/jaw", "effort/jaw"], "recording"),
    "linear in play operators": (
        "linear",
        list(DATASETS["davinci_grasper_umn"].features),
        "recording",
    ),
    "ridge on plays": (PLAYS, ["measured/jaw", "effort/jaw"], "recording"),
    RULE: (PLAYS, ["measured/jaw", "effort/jaw", "motor/jaw"], "recording"),
    "ridge on plays, zero moves the input": (PLAYS, ["measured/jaw", "effort/jaw"], "homing"),
    "ukf_elastic": ("ukf_elastic", ["driver/jaw", "effort/jaw"], "recording"),
}


def folder(number: int) -> list[Recording]:
    """Files of one posture."""
    return read_dataset("davinci_grasper_umn", f"Tool_4_Maryland_L_Pitch_{number}/*")


def coupled(recording: Recording, pitch: float) -> Recording:
    """Take off what the `pitch` [deg] of the wrist drags the jaw by, as its coupling says.

    The jaw is then where rigid cables would have it, whichever way the wrist is bent.
    """
    matrix = get_robot("wrist", TOOL).transmission.inverse  # type: ignore[union-attr]
    dragged = np.radians(pitch) * matrix[1, 0]
    table = recording.table.assign(
        **{
            "measured/jaw": recording.column("measured/jaw") + dragged,
            "driver/jaw": recording.column("driver/jaw") - dragged / matrix[1, 1],
        }
    )
    own = replace(recording.provenance, homing_id=recording.provenance.session)
    return Recording(table, recording.units, own)


@dataclass(frozen=True)
class Stroke:
    """What the closing and the opening strokes of a posture say."""

    slopes: tuple[float, float]  # spindle torque per jaw torque, closing and opening
    constants: tuple[float, float]  # [Nm]

    @property
    def exponent(self) -> float:
        """``mu phi`` of the capstan equation, over the whole cable."""
        return 0.5 * float(np.log(self.slopes[0] / self.slopes[1]))

    @property
    def ratio(self) -> float:
        """Spindle torque per jaw torque without friction."""
        return float(np.sqrt(self.slopes[0] * self.slopes[1]))


Points = dict[bool, tuple[float, float]]
"""Spindle and jaw torque [Nm] of a file's closing (True) and opening strokes."""


def points(recording: Recording) -> Points:
    """Mean torques of one file in either direction of sliding."""
    driver = recording.column("driver/jaw")
    speed = savgol_filter(driver, 201, 2, deriv=1, delta=1e-3)
    low, high = np.quantile(driver, [0.02, 0.98])
    middle = np.abs(driver - 0.5 * (low + high)) < MIDDLE * 0.5 * (high - low)
    torques = np.column_stack([recording.column("effort/jaw"),
                               recording.column("truth_effort/jaw")])  # fmt: skip
    found = {}
    for closing in (True, False):
        sliding = (speed < -SLIDING) if closing else (speed > SLIDING)
        if (sliding & middle).sum() > 100:
            spindle, jaw = torques[sliding & middle].mean(axis=0)
            found[closing] = float(spindle), float(jaw)
    return found


def stroke(files: Sequence[Points]) -> Stroke:
    """Fit spindle torque against jaw torque, a point a file, in either direction of sliding."""
    slopes, constants = [], []
    for closing in (True, False):
        spindle, jaw = np.array([file[closing] for file in files if closing in file]).T
        slope, constant = np.polyfit(np.abs(jaw), spindle, 1)
        slopes.append(abs(float(slope)))
        constants.append(float(constant))
    return Stroke((slopes[0], slopes[1]), (constants[0], constants[1]))


def exponent_deviation(files: Sequence[Points]) -> float:
    """Draw files anew (bootstrap) for the standard deviation of `Stroke.exponent`."""
    rng = np.random.default_rng(0)
    draws = rng.integers(len(files), size=(DRAWS, len(files)))
    return float(np.std([stroke([files[n] for n in own]).exponent for own in draws]))


def lines(recordings: Sequence[Recording]) -> Array:
    """Offset [rad], jaw per spindle and stretch [rad/Nm] of each file (n, 3)."""
    found = []
    for recording in recordings:
        driver, effort = recording.column("driver/jaw"), recording.column("effort/jaw")
        design = np.column_stack([np.ones_like(driver), driver, effort])
        found.append(np.linalg.lstsq(design, recording.column("truth/jaw"), rcond=None)[0])
    return np.array(found)


def identified() -> None:
    """Print coupling and friction of each posture, and what the instrument's file says."""
    matrix = get_robot("wrist", TOOL).transmission.inverse  # type: ignore[union-attr]
    per_disc, per_pitch = float(matrix[1, 1]), float(-matrix[1, 0])
    print("\n| pitch | jaw per disc | stretch [deg/Nm] | offset | mu phi | ratio | slopes |")
    print("|---|---|---|---|---|---|---|")
    offsets, spreads, files, gains = [], [], [], []
    for number, pitch in PITCH.items():
        recordings = folder(number)
        own, strokes = lines(recordings), [points(r) for r in recordings]
        found = stroke(strokes)
        middle, spread = np.mean(own, axis=0), np.std(own, axis=0)
        offsets.append(np.degrees(middle[0]))
        # The zero of a file strays from that of its posture, and the posture from the protractor.
        spreads.append(np.degrees(spread[0]) / math.sqrt(len(own)))
        files += strokes
        gains.append(-middle[1])
        print(
            f"| {pitch:+.0f} | {-middle[1]:.3f} +- {spread[1]:.3f} | "
            f"{np.degrees(middle[2]):.1f} | {offsets[-1]:.1f} +- {np.degrees(spread[0]):.1f} | "
            f"{found.exponent:.3f} +- {exponent_deviation(strokes):.3f} | {found.ratio:.3f} | "
            f"{found.slopes[0]:.2f} {found.slopes[1]:.2f} |",
            flush=True,
        )
    angles = np.array(list(PITCH.values()))
    slope = abs(float(np.polyfit(angles, offsets, 1)[0]))
    variance = np.square(spreads) + (slope * BY_HAND) ** 2
    away = angles - angles.mean()
    deviation = math.sqrt(float(np.sum(away**2 * variance))) / float(np.sum(away**2))
    whole = stroke(files)
    # Postures differ by more than their files do: each counts as one draw.
    gain_deviation = np.std(gains, ddof=1) / math.sqrt(len(gains))
    print(f"\njaw per disc {np.mean(gains):.3f} +- {gain_deviation:.3f}, "
          f"published {per_disc:.3f}", end="; ")  # fmt: skip
    by_protractor = BY_HAND / math.sqrt(float(np.sum(away**2)))
    print(f"jaw per pitch {slope:.3f} +- {deviation:.3f} ({by_protractor:.1%} by the protractor), "
          f"published {per_pitch:.3f}", end="; ")  # fmt: skip
    print(f"mu phi of all files {whole.exponent:.3f} +- {exponent_deviation(files):.3f}")


def off(model: Calibration, recordings: Sequence[Recording]) -> tuple[Array, Array]:
    """RMS error [deg] of each file, one offset of it taken off, and re-zeroed (n,)."""
    centred, rezeroed = [], []
    for recording in recordings:
        truth = recording.column("truth/jaw")
        error = zeroed(model, recording, math.inf).correct(recording)[:, 0] - truth
        centred.append(np.std(error))
        after = recording.t - recording.t[0] > REZERO
        again = zeroed(model, recording, REZERO).correct(recording)[:, 0] - truth
        rezeroed.append(np.sqrt(np.mean(again[after] ** 2)))
    return np.degrees(centred), np.degrees(rezeroed)


def zeros(model: Calibration, recordings: Sequence[Recording]) -> str:
    """Say how far zeros stray from file to file, and how far `REZERO` seconds miss them."""
    whole, brief = (
        np.degrees([find_zero(model, r, duration).offset[0] for r in recordings])
        for duration in (math.inf, REZERO)
    )
    missed = float(np.sqrt(np.mean((brief - whole) ** 2)))
    return f"zeros stray by {np.std(whole):.2f}, {REZERO:g} s miss them by {missed:.2f}"


def held_out() -> None:
    """Print the errors at each posture of models fitted at pitch 0, half of whose files judge."""
    by_pitch = {p: [coupled(r, p) for r in folder(number)] for number, p in PITCH.items()}
    print("\n| fitted at pitch 0 | " + " | ".join(f"{p:+.0f} offset off | re-zeroed"
          for p in PITCH.values()) + " |")  # fmt: skip
    print("|---|" + "---|---|" * len(PITCH))
    told: list[str] = []
    for name, how in METHODS.items():
        cells = []
        for pitch, recordings in by_pitch.items():
            if pitch:
                model = fitted(by_pitch[0.0], *how)
                found = off(model, recordings)
                if name == RULE:
                    told.append(f"{pitch:+.0f}: {zeros(model, recordings)}")
            else:  # each half judged by a model of the other
                halves = [recordings[::2], recordings[1::2]]
                pairs = [off(fitted(a, *how), b) for a, b in (halves, halves[::-1])]
                found = tuple(np.concatenate(pair) for pair in zip(*pairs, strict=True))  # type: ignore[assignment]
            cells += [f"{np.sqrt(np.mean(values**2)):.2f}" for values in found]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
    print(f"\n{RULE}, deg: " + "; ".join(told))


def fitted(
    recordings: Sequence[Recording], estimator: str | Plays, features: list[str], zero: ZeroOf
) -> Calibration:
    """Calibrate with a zero for each file, as the files have."""
    model = calibrate(recordings, estimator, features=features, zero=zero, fit_rate=FIT_RATE)
    return model.for_rezeroing


def main() -> None:
    """Print the tables."""
    parts = {"identified": identified, "held-out": held_out}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", nargs="+", choices=list(parts), default=list(parts))
    for name in parser.parse_args().part:
        parts[name]()


if __name__ == "__main__":
    main()
