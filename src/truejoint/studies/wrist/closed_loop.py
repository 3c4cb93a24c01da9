"""Setting the joints and the grip of a wrist and not its motors: estimates, a perfect sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.crtk import Arm
from truejoint.errors import CommandRefused, StudyError
from truejoint.robots.blocks import SETPOINT_DT, StateBlock, TruthBlock
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.runtime import Corrector, Status
from truejoint.runtime.compensator import check_rate
from truejoint.simulation.twin import hold
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.loop import TwinSignals, homed_arm
from truejoint.studies.rows import Cell, each, ecdf_figure, median, select, table_of
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.studies.wrist import motions
from truejoint.studies.wrist.accuracy import METHODS, by_joint, joint_medians, rms, specimens, worst
from truejoint.studies.wrist.grip import ForwardLoop, gripping
from truejoint.tables import Table

OPEN: Final = "open"
JOINT, GRIP = "joint", "grip"
"""What a row is of."""
Judge = Callable[[Array], dict[str, float]]
_HYBRID: Final = "hybrid"


@dataclass(frozen=True)
class Around:
    """What stands in a loop: a calibration by name, or `exact` what only a simulation knows."""

    title: str
    model: str = _HYBRID
    exact: bool = False
    forward: bool = False


PERFECT: Final = "perfect"
PERFECT_FORWARD: Final = "perfect_forward"
LOOPS: Final[Mapping[str, Around]] = {
    "play_motor": Around("plays, motors", "play_motor"),
    "play_effort": Around("plays, motors and effort", "play_effort"),
    "filter": Around("physical filter", "filter"),
    _HYBRID: Around("filter and plays"),
    "hybrid_forward": Around("filter and plays, fed forward", forward=True),
    PERFECT: Around("a perfect sensor", exact=True),
    PERFECT_FORWARD: Around("a perfect sensor, fed forward", exact=True, forward=True),
}
TITLES: Final = {OPEN: "none, an offset taken off", **{k: v.title for k, v in LOOPS.items()}}
"""What stands in the loop."""
MODELS: Final[Mapping[str, tuple[Any, list[str] | None]]] = {
    **{
        key: (METHODS[key].estimator, METHODS[key].features)
        for key in ("play_motor", "play_effort")
    },
    "filter": ("ukf_cables", None),
    _HYBRID: ("hybrid_cables", None),
}
"""Estimator and features of each calibration: free, and, but for motors alone, under loads too."""
CASES: Final = {"free": False, "tip": True}
"""Without a load, and with pushes of up to 2 N at the tip."""
GRIPS: Final = {"standing": False, "moving": True}
"""Something is gripped while pitch and yaw stand still, and while they step."""
SEES_GRIP: Final = ("filter", _HYBRID, PERFECT)
"""Loops that grip; what is fed forward there is how cables give way."""

# Where an estimator is sure of itself it is believed beyond what calibration saw.
_BELIEVED: Final = Status.OUT_OF_DOMAIN | Status.OUT_OF_RANGE | Status.IMPLAUSIBLE
_QUICK: Final = 0.01  # [s] in which what is lost is made up for
_SETTLED: Final = 2.0  # [s] at the first pose, which are not judged
_MOMENT: Final = 0.5  # [s] after a step of the grip, from which it counts as standing
_STILL: Final = np.radians([10.0, 5.0])  # [rad] pitch and yaw where only the grip changes
_APART: Final = math.radians(20.0)  # [rad] of the jaws before they grip
_HELD: Final = math.radians(15.0)  # [rad] of what is between them


class PerfectSensor(Corrector):
    """A corrector that is told by an arm on a twin where the joints are, and how they grip."""

    def __init__(self, model: Calibration, arm: Arm) -> None:
        super().__init__(model)
        self.beside = {"grip": np.zeros(2)}
        self._exact = np.full(len(self.joints), np.nan)
        self._at = [self.signals.index(f"measured/{name}") for name in self.joints]
        arm.subscribe(self._hear)

    def _hear(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, StateBlock) and len(block.t):
            by_name = [block.extra[f"truth_exact/{name}"][-1] for name in self.joints]
            self._exact = np.array(by_name)
            self.beside["grip"][0] = block.extra["truth_load/grip"][-1]

    def step(self, t: float, sample: Any) -> Status:
        """Set the correction to what the joints are off."""
        super().step(t, sample)
        self.correction[:] = self._exact - np.asarray(sample)[self._at]
        return Status.OK


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    if not settings["seconds"] >= _SETTLED:  # a step of the grip, and what follows it
        raise StudyError(f"seconds={settings['seconds']:g}; it must be {_SETTLED:g} or more")
    if abs(math.remainder(1.0 / SETPOINT_DT, settings["rate_hz"])) > 1e-6:
        raise StudyError(f"rate_hz={settings['rate_hz']:g}; it must divide the arm's 1 kHz")
    settings.check_names("loop", "loops", TITLES)
    found = specimens(settings, judge, "free_s", "loaded_s", "seconds", "rate_hz", "gain", "loops")
    for part in found:
        plant = WristParameters.from_dict(part.arguments["specimen"])
        check_rate(settings["rate_hz"], plant.motor.lag, settings["gain"])
    return found


def judge(
    specimen: Mapping[str, Mapping[str, Any]],
    number: int,
    free_s: float,
    loaded_s: float,
    seconds: float,
    rate_hz: float,
    gain: float,
    loops: Sequence[str],
) -> Rows:
    """RMS errors of joints [rad] and grip [Nm] by what is in the loop; what a loop refused."""
    # Every loop begins with the same zeros: what a homing moves no estimate can know.
    plant = WristParameters.from_dict(specimen).with_values({"homing.registration": 0.0})
    seed = 4 * number
    free, loaded = motions.calibrating(WristTwin(plant, seed=number), free_s, loaded_s, seed)
    keys = [key for key in TITLES if key in {*loops, PERFECT}]
    used = {"play_motor"} | {LOOPS[key].model for key in keys if key != OPEN}
    models = {
        key: calibrate([free] if key == "play_motor" else [free, loaded], MODELS[key][0],
                       features=MODELS[key][1], joints=JOINTS)
        for key in MODELS if key in used
    }  # fmt: skip
    bench = Bench(plant, number, models, rate_hz, gain)
    off = (free.columns("truth", JOINTS) - free.columns("measured", JOINTS)).mean(axis=0)
    pose = motions.steps(seconds, seed + 2)
    wanted = np.vstack([hold(motions.joints(pose[:1])[0], _SETTLED), motions.joints(pose)])
    rows: Rows = []

    def tried(labels: dict[str, str], run: Callable[[], Array], judge: Judge) -> None:
        """Add a row on what a loop did, or on why it refused."""
        try:
            rows.append({**labels, **judge(run())})
        except CommandRefused as refused:
            rows.append({**labels, "refused": str(refused)})

    for (case, pushed), key in product(CASES.items(), keys):
        run = partial(bench.follow, key, wanted, off, pushed)
        tried({"of": JOINT, "load": case, "loop": key}, run, lambda error: by_joint(rms(error)))
    for case, moving in GRIPS.items():
        path, grip = motions.grip_steps(seconds, seed + 3)
        if not moving:
            path[:] = np.append(_STILL, 0.0)
        path[:, 2] = _APART
        for key in filter(SEES_GRIP.__contains__, keys):
            run = partial(bench.grip, key, motions.joints(path), grip)
            tried({"of": GRIP, "load": case, "loop": key}, run, partial(judged_grip, wanted=grip))
    return rows


@dataclass(frozen=True, eq=False)
class Bench:
    """An instrument that loops are tried on, each homed anew, with what they are made of."""

    plant: WristParameters
    number: int
    models: Mapping[str, Calibration]
    rate: float
    gain: float

    def follow(self, key: str, wanted: Array, offset: Array, pushed: bool) -> Array:
        """Joints less wanted (n, 3) [rad] along `wanted` at 1 kHz, from the end of its pause.

        Raises CommandRefused where the loop does.
        """
        twin, arm = self._arm()
        arm.move_jp(wanted[0] - offset if key == OPEN else wanted[0]).wait()
        if pushed:
            force = motions.pushes(len(wanted), self.number)
            twin.tip_force = motions.later(twin.time + _SETTLED, force)
        signals = TwinSignals(arm, [f"truth_exact/{name}" for name in JOINTS])
        if key == OPEN:
            arm.servo_jp_stream(wanted - offset)
        else:
            self._loop(key, arm).drive(arm, wanted)
        error = signals.table()[-len(wanted) :] - wanted
        return np.asarray(error[round(_SETTLED / SETPOINT_DT) :])

    def grip(self, key: str, path: Array, wanted: Array) -> Array:
        """Grip (n,) [Nm] of jaws that are to grip as `wanted` (n,) on their path (n, 3) at 1 kHz.

        Raises CommandRefused where the loop does.
        """
        twin, arm = self._arm()
        arm.move_jp(path[0]).wait()
        twin.held = lambda t: np.full(len(t), _HELD)
        signals = TwinSignals(arm, ["truth_load/grip"])
        loop = self._loop(key, arm)
        pieces = loop.setpoints(arm, gripping(loop, arm.robot, path, wanted, arm.rate))
        arm.stream(pieces, len(path) * SETPOINT_DT, "grip").wait()
        return signals.values("truth_load/grip")[-len(path) :]

    def _arm(self) -> tuple[WristTwin, Arm]:
        twin = WristTwin(self.plant, seed=self.number)
        return twin, homed_arm(twin)

    def _loop(self, key: str, arm: Arm) -> ForwardLoop:
        around = LOOPS[key]
        model = self.models[around.model].without_redundant()
        if around.exact:
            corrector: Corrector = PerfectSensor(model, arm)
        else:
            corrector = Corrector(model)
        corrector.set_homing(True)
        ahead = self.models["play_motor"] if around.forward else None
        return ForwardLoop(
            corrector, arm.robot, ahead, rate=self.rate, lag=self.plant.motor.lag, gain=self.gain,
            time_constant=_QUICK, integral_time=math.inf, believed=_BELIEVED,
        )  # fmt: skip


def judged_grip(force: Array, wanted: Array) -> dict[str, float]:
    """RMS [Nm] of grip less wanted (n,): over all, and where it has stood for half a second.

    And by how much, in the median, it goes beyond where a step ends.
    """
    first = round(_SETTLED / SETPOINT_DT)
    error, change = force - wanted, np.diff(wanted, prepend=wanted[0])
    ends = np.flatnonzero((change[:-1] != 0.0) & (change[1:] == 0.0)) + 1
    ends = ends[ends >= first]
    moment = round(_MOMENT / SETPOINT_DT)
    stands = np.ones(len(error), dtype=bool)
    stands[:first] = False
    for row in np.flatnonzero(change):
        stands[row : row + moment] = False
    beyond = [np.max(np.sign(change[e - 1]) * error[e : e + moment]) for e in ends]
    return {
        "rms": float(np.sqrt(np.mean(error[first:] ** 2))),
        "standing": float(np.sqrt(np.mean(error[stands] ** 2))),
        "overshoot": float(np.median(beyond)),
    }


def summarise(results: Results) -> Summary:
    """Medians by family and case, each loop beside that of a perfect sensor."""
    settings, rows = results.settings, results.rows
    rows = rows.assign(refused=None) if "refused" not in rows else rows
    refused, done = rows[rows.refused.notna()], rows[rows.refused.isna()]
    joint_cells: dict[str, Cell] = {
        "n": lambda group: str(len(group)),
        "pitch jaw1 jaw2": joint_medians,
        "worst": worst,
    }
    joints = (
        f"RMS of joint less wanted in degrees along {settings['seconds']:g} s of steps with rests, "
        f"medians of the specimens of seed {settings.seed}; the loop runs at "
        f"{settings['rate_hz']:g} Hz. tip: pushes up to 2 N. The last column is the median of the "
        "ratio to the same loop, not fed forward, around a sensor that knows the joints exactly."
    )
    grip_cells: dict[str, Cell] = {
        "n": lambda group: str(len(group)),
        "RMS (worst)": median("rms", 1, 1e3),
        "between steps": median("standing", 1, 1e3),
        "overshoot": lambda group: f"{1e3 * group.overshoot.median():.1f}",
    }
    grip = (
        "Grip less wanted in mNm, medians of the specimens: jaws close on something, grip it at "
        "10 to 70 mNm in minimum-jerk steps of 0.3 s, and hold each for 1 to 2 s; standing, and "
        "while pitch and yaw step too. Between steps counts from 0.5 s after each."
    )
    of_joint = select(done, of=JOINT)
    tables = [
        _table("Joints in a closed loop", of_joint, JOINTS, joint_cells, joints),
        _table("Grip in a closed loop", select(done, of=GRIP), ("rms",), grip_cells, grip),
    ]
    if len(refused):
        body = tuple((r.part, r.load, TITLES[r.loop], r.refused) for r in each(refused))
        header = ("instrument", "load", "in the loop", "refused")
        tables.append(Table("Loops that refused", header, body))
    named = of_joint.assign(name=of_joint.loop.map(TITLES))[["load", "name", *JOINTS]]
    errors = named.melt(["load", "name"], list(JOINTS), "joint", "rms")
    caption = "Share of all specimens' joints with a smaller error, without and with pushes."
    title = "Joints in a closed loop"
    return Summary(tables, {"wrist-loop": ecdf_figure(title, errors, "name", "load", caption)})


def _table(
    title: str, rows: DataFrame, columns: Sequence[str], cells: dict[str, Cell], note: str
) -> Table:
    """Table of specimens where a perfect sensor was tried too, with the ratio to it."""
    perfect = select(rows, loop=PERFECT)[["load", "specimen", *columns]]
    both = rows.merge(perfect, on=["load", "specimen"], suffixes=("", "_perfect"))
    ratio = both[list(columns)].to_numpy() / both[[f"{c}_perfect" for c in columns]].to_numpy()
    both = both.assign(ratio=list(ratio), place=both.loop.map(list(TITLES).index))
    both = both.sort_values(["load", "family", "place"], kind="stable")
    cells["of perfect"] = lambda group: f"{np.median(np.concatenate(group.ratio.to_list())):.2f}"
    return table_of(
        title, both, ["load", "family", "loop"], cells, (note,),
        names=lambda load, family, loop: f"{load}, {family}, {TITLES[loop]}",
        head="load, family, in the loop",
    )  # fmt: skip
