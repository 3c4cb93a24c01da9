"""Setting the joints of a wrist and not its motors: estimates in the loop, and a perfect sensor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, cast

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.crtk import Arm
from truejoint.crtk.backends.simulated import SimulatedBackend
from truejoint.errors import StudyError
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.robots.joint_rows import SETPOINT_DT
from truejoint.runtime import Compensator, Corrector, Status, compensated_motion
from truejoint.runtime.compensator import check_rate
from truejoint.simulation.twin import Twin, hold
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.study import Part, PartResult, Settings, Summary, check_counts
from truejoint.studies.table import Table
from truejoint.studies.wrist import motions
from truejoint.studies.wrist.accuracy import METHODS, rms, specimens
from truejoint.studies.wrist.physical import JOINTS

OPEN: Final = "open"
PERFECT: Final = "perfect"
TITLES: Final = {
    OPEN: "none, an offset taken off",
    "play_motor": "plays, motors",
    "play_effort": "plays, motors and effort",
    PERFECT: "a perfect sensor",
}
"""What stands in the loop."""
CASES: Final = {"free": False, "tip": True}
"""Without a load, and with pushes of up to 2 N at the tip."""

# Where an estimator is sure of itself it is believed beyond what calibration saw.
_BELIEVED: Final = Status.OUT_OF_DOMAIN | Status.OUT_OF_RANGE | Status.IMPLAUSIBLE
_QUICK: Final = 0.01  # [s] in which what is lost is made up for
_SETTLED: Final = 2.0  # [s] at the first pose, which are not judged


class PerfectSensor(Corrector):
    """A corrector that is told by an arm on a twin where the joints are."""

    def __init__(self, model: Calibration, arm: Arm) -> None:
        super().__init__(model)
        self._exact = np.full(len(self.joints), np.nan)
        self._at = [self.signals.index(f"measured/{name}") for name in self.joints]
        arm.subscribe(self._hear)

    def _hear(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, StateBlock) and len(block.t):
            known = [block.extra[f"truth_exact/{name}"][-1] for name in self.joints]
            self._exact = np.array(known)

    def step(self, t: float, sample: Any) -> Status:
        """Set the correction to what the joints are off."""
        super().step(t, sample)
        self.correction[:] = self._exact - np.asarray(sample)[self._at]
        return Status.OK


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    check_counts(settings, "free_s", "loaded_s", "seconds", "rate_hz")
    if abs(math.remainder(1.0 / SETPOINT_DT, settings["rate_hz"])) > 1e-6:
        raise StudyError(f"rate_hz={settings['rate_hz']:g}; it must divide the arm's 1 kHz")
    found = specimens(settings, judge, "free_s", "loaded_s", "seconds", "rate_hz", "gain")
    for part in found:
        plant = WristParameters.from_dict(part.arguments["specimen"])
        check_rate(settings["rate_hz"], plant.motor.lag, settings["gain"])
    return found


def judge(
    specimen: Mapping[str, Mapping[str, Any]],
    family: str,
    number: int,
    free_s: float,
    loaded_s: float,
    seconds: float,
    rate_hz: float,
    gain: float,
) -> PartResult:
    """RMS tracking errors [rad] of every joint by what is in the loop, free and pushed."""
    # Every loop begins with the same zeros: what a homing moves no estimate can know.
    plant = WristParameters.from_dict(specimen).with_values({"homing.registration": 0.0})
    twin = WristTwin(plant, seed=number)
    twin.home()
    seed = 4 * number
    free = motions.record(twin, motions.multi_sine, free_s, seed, load=False)
    loaded = motions.record(twin, motions.multi_sine, loaded_s, seed + 1, load=True)
    models = {
        key: calibrate(data, METHODS[key].estimator, features=METHODS[key].features, joints=JOINTS)
        for key, data in (("play_motor", [free]), ("play_effort", [free, loaded]))
    }
    off = free.columns("truth", JOINTS) - free.columns("measured", JOINTS)
    pose = motions.steps(seconds, seed + 2)
    wanted = np.vstack([hold(motions.joints(pose[:1])[0], _SETTLED), motions.joints(pose)])
    errors: dict[str, dict[str, list[float]]] = {}
    arrays: dict[str, Array] = {}
    for case, pushed in CASES.items():
        errors[case] = {}
        for key in TITLES:
            model = models.get(key, models["play_effort"])
            error = follow(
                plant, number, key, model, wanted, off.mean(axis=0), pushed, rate_hz, gain
            )
            errors[case][key] = rms(error)
            arrays[f"{case}/{key}"] = error[::10]
    return PartResult({"family": family, "errors": errors}, arrays)


def follow(
    plant: WristParameters,
    number: int,
    key: str,
    model: Calibration,
    wanted: Array,
    offset: Array,
    pushed: bool,
    rate: float,
    gain: float,
) -> Array:
    """Joints less wanted (n, 3) [rad] along `wanted` at 1 kHz, from the end of its first pause."""
    twin = WristTwin(plant, seed=number)
    arm = Arm(SimulatedBackend(cast("Twin", twin)))
    arm.enable()
    arm.home()
    arm.move_jp(wanted[0] - offset if key == OPEN else wanted[0]).wait()
    if pushed:
        start = twin.time + _SETTLED
        force = motions.pushes(len(wanted), number)
        twin.tip_force = motions.later(start, force)
    heard: list[Array] = []

    def hear(block: StateBlock | TruthBlock) -> None:
        if isinstance(block, StateBlock):
            heard.append(np.column_stack([block.extra[f"truth_exact/{name}"] for name in JOINTS]))

    arm.subscribe(hear)
    if key == OPEN:
        arm.servo_jp_stream(wanted - offset)
    else:
        used = model.without_redundant()
        corrector = PerfectSensor(used, arm) if key == PERFECT else Corrector(used)
        corrector.set_homing(True)
        compensator = Compensator(
            corrector, arm.robot, rate=rate, lag=plant.motor.lag, gain=gain, time_constant=_QUICK,
            integral_time=math.inf, believed=_BELIEVED,
        )  # fmt: skip
        compensated_motion(arm, compensator, wanted)
    exact = np.concatenate(heard)[-len(wanted) :]
    return np.asarray((exact - wanted)[round(_SETTLED / SETPOINT_DT) :])


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Medians by family and case, each loop beside that of a perfect sensor."""
    numbers = [result.numbers for result in results.values()]
    rows = []
    for case in CASES:
        for family in dict.fromkeys(n["family"] for n in numbers):
            own = [n["errors"][case] for n in numbers if n["family"] == family]
            best = np.array([one[PERFECT] for one in own])
            for key, title in TITLES.items():
                error = np.array([one[key] for one in own])
                middle = " ".join(f"{v:.3f}" for v in np.degrees(np.median(error, axis=0)))
                ratio = f"{np.median(error / best):.2f}"
                worst = f"{np.degrees(error.max()):.2f}"
                rows.append((case, family, title, str(len(own)), middle, worst, ratio))
    header = ("load", "family", "in the loop", "n", "pitch jaw1 jaw2", "worst", "of perfect")
    notes = (
        f"RMS of joint less wanted in degrees along {settings['seconds']:g} s of steps with rests, "
        f"medians of the specimens of seed {settings.seed}; the loop runs at "
        f"{settings['rate_hz']:g} Hz. tip: pushes up to 2 N. The last column is the median of the "
        "ratio to the same loop around a sensor that knows the joints exactly.",
    )
    table = Table("Joints in a closed loop", header, tuple(rows), notes)
    first = next(iter(results.values()))
    panels = []
    for j, joint in enumerate(JOINTS):
        curves = []
        for n, (key, title) in enumerate(TITLES.items()):
            error = np.degrees(first.arrays[f"tip/{key}"][:, j])
            t = np.arange(len(error)) * 10.0 * SETPOINT_DT
            curves.append(Curve(t, error, title, f"C{n}"))
        panels.append(Panel(curves, "time [s]", "joint less wanted [deg]", joint))
    caption = "First specimen, pushed at its tip."
    figure = Figure("Joints in a closed loop", (panels,), caption, legend=True, height=4.5)
    return Summary((table,), {"wrist-loop": figure})
