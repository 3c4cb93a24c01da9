"""What a corrector keeps in its memory."""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal, get_args

import numpy as np

from truejoint.calibration.calibration import Calibration
from truejoint.calibration.conditions import CELLS, N_MOTION, N_RATE
from truejoint.calibration.interval import check_level, inverse_span
from truejoint.errors import CalibrationError, unknown
from truejoint.layout import Layout, Memory
from truejoint.runtime.limits import Limits
from truejoint.runtime.status import Status

HOMING_UNKNOWN: Final = 0
HOMING_OF_CALIBRATION: Final = -1
"""Numbers of homings: one without a name, the first of those of the training (which are negative);
others are positive."""

Reaction = Literal["hold", "raw", "silent"]
HOLD, RAW, SILENT = range(3)
"""Numbers of the reactions."""


@dataclass(frozen=True)
class OnFault:
    """Output of a corrector for a sample that it does not believe.

    Attributes
    ----------
    reaction : {"hold", "raw", "silent"}
        The measured position with the correction that was believed last; the measured position as
        it is; or NaN.
    hold_s : float
        Time for which "hold" keeps the correction [s]. Then it takes the correction back.
    speed_rad_s, speed_m_s : float
        Speed at which "hold" takes the correction back, and at which it goes to the next one that
        it believes [rad/s, m/s].

    Raises
    ------
    CalibrationError
        If there is no such reaction, or a number is negative or not finite.

    Examples
    --------
    >>> Corrector(model, on_fault=OnFault(hold_s=0.5)).position
    array([nan])
    """

    reaction: Reaction = "hold"
    hold_s: float = 1.0
    speed_rad_s: float = math.radians(2.0)
    speed_m_s: float = 2e-3

    def __post_init__(self) -> None:
        reactions = get_args(Reaction)
        if self.reaction not in reactions:
            raise CalibrationError(unknown("on_fault", self.reaction, reactions))
        for name in ("hold_s", "speed_rad_s", "speed_m_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise CalibrationError(f"{name} is {value!r:.60}; give a number of at least 0")


LAYOUT: Final = Layout().declare(
    __package__, "corrector", N_RATE=N_RATE, N_MOTION=N_MOTION, N_SWINGS=CELLS**2
)
NEEDS_REZERO, HOMING, HOMING_ID, OWN_ID, IS_HOMED, TOLD_ID, WAS_LOST, REZEROED = LAYOUT.places(
    "needs_rezero homing homing_id own_id is_homed told_id was_lost rezeroed"
)
HAS_STAMP, HAS_LAST, WAS_STALE, HAS_SPIKED, N_LATE, HAS_OUTPUT, IS_DOUBTED, SUSPECT, ANCHOR = (
    LAYOUT.places(
        "has_stamp has_last was_stale has_spiked n_late has_output is_doubted suspect anchor"
    )
)
T, STAMP, LAST_T, PARITY_T, CHANGED_T, OUTPUT_T, DOUBTED_TIME, LATE, TRAINING_DT, EXCESS = (
    LAYOUT.places("t stamp last_t parity_t changed_t output_t doubted_time late training_dt excess")
)
ROW, MODEL, UNLEARNT = LAYOUT.places("row model unlearnt")

unpack = LAYOUT.unpacker()
"""Give a kernel numbers and arrays of a corrector by name."""


def pack(
    data: Calibration, limits: Limits, level: float | None, on_fault: OnFault | Reaction = "hold"
) -> Memory:
    """Memory of a corrector before its first sample, not homed.

    `level` says which half-widths of the interval to use; without one 0.9, where there is an
    interval. Raises CalibrationError if it is no share, the model states no half-width for it to
    be of, or the estimator only works offline.
    """
    family = data.family
    knows_deviation = family.states_deviation(data.fitted.params)
    if level is not None:
        check_level(level)
        if not knows_deviation:
            data.required_interval()
    level = data.usual_level if level is None else level
    fault = on_fault if isinstance(on_fault, OnFault) else OnFault(on_fault)
    speeds = {"rad": fault.speed_rad_s, "m": fault.speed_m_s}
    operation, source, parameter, slot = data.feature_set.program
    signals = data.loop_signals
    n_signals, k, n_joints = len(signals), len(data.feature_set), len(data.joints)
    base, growth = np.full(n_joints, np.inf), 0.0
    if data.interval is not None:
        base, growth = data.interval.half_width(level), data.interval.growth
    model = family.memory(data.fitted, k, n_joints)
    deviations = NormalDist().inv_cdf(0.5 + 0.5 * level)
    if data.interval is None and knows_deviation:
        place = model.layout.fields["deviations"].index
        model.memory[place] = deviations
    for path in set(family.beside(data.fitted.params).values()):
        own_part = model.part(*path)
        own_part.memory[own_part.layout.fields["beside_deviations"].index] = deviations
    shift = np.pad(data.signal_shift, (0, n_signals - len(data.signals)))
    # Parity is that of the signals as they come, whatever is added to them for the model.
    moved = (limits.parity * shift[limits.parity_terms]).sum(axis=1)
    nothing = np.full(n_joints, np.nan)
    return LAYOUT.pack(
        {"row": family.row},
        **(vars(limits) | {"parity_intercept": limits.parity_intercept - moved}),
        needs_rezero=data.interval is not None and data.interval.rezero > 0.0,
        zeroed=data.zero is not None, homing=int(Status.NOT_HOMED),
        own_id=HOMING_OF_CALIBRATION if data.origin.homing_ids else HOMING_UNKNOWN,
        n_shifted=len(data.signals) if shift.any() else 0,
        is_position=data.target == "position", row=family.row_address(),
        growth=growth, position=nothing, correction=nothing, reported=nothing,
        remembers=data.looks_back, on_fault=get_args(Reaction).index(fault.reaction),
        hold_time=fault.hold_s,
        return_speed=[speeds[data.machine.joint(joint).unit] for joint in data.joints],
        half_width=np.full(n_joints, np.inf), base_width=base,
        shift=shift, added=data.output_shift,
        feature_memory=np.zeros(data.feature_set.memory_size), operation=operation,
        source=source, parameter=parameter, slot=slot, trained_lower=data.lower,
        trained_upper=data.upper, per_span=inverse_span(data.lower, data.upper), model=model,
        measured=[signals.index(f"measured/{joint}") for joint in data.joints],
    )  # fmt: skip
