"""What a corrector keeps in its memory."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal, get_args

import numpy as np

from truejoint.calibration.calibration import Calibration
from truejoint.calibration.interval import LEVEL, check_level, inverse_span
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


LAYOUT: Final = Layout()
LAYOUT.integer("n_signals", "in a sample")
LAYOUT.integer("n_features", "inputs of the model")
LAYOUT.integer("n_joints", "outputs of the model")
LAYOUT.integer("n_shifted", "first signals whose zero may have moved")
LAYOUT.integer("n_parity", "parity equations")
LAYOUT.integer("n_terms", "signals in a parity equation")
LAYOUT.integer("n_white", "features, filled up to a multiple of 4")
LAYOUT.integer("is_position", "1: the model predicts it, 0: the error")
NEEDS_REZERO: Final = LAYOUT.integer("needs_rezero", "1: half-widths are those after `rezero`")
ZEROED: Final = LAYOUT.integer("zeroed", "1: the calibration was re-zeroed after its homing")
HOMING: Final = LAYOUT.integer("homing", "status bits of the homing")
HOMING_ID: Final = LAYOUT.integer("homing_id", "the homing that positions refer to")
OWN_ID: Final = LAYOUT.integer("own_id", "the homing of the calibration")
IS_HOMED: Final = LAYOUT.integer("is_homed", "what was told last: whether the robot is homed")
TOLD_ID: Final = LAYOUT.integer("told_id", "and which homing its positions refer to")
WAS_LOST: Final = LAYOUT.integer("was_lost", "whether the robot was homed anew")
REZEROED: Final = LAYOUT.integer("rezeroed", "whether an offset was given for this homing")
HAS_STAMP: Final = LAYOUT.integer("has_stamp", "whether there was a sample")
HAS_LAST: Final = LAYOUT.integer("has_last", "whether a sample was used")
WAS_STALE: Final = LAYOUT.integer("was_stale", "whether stamps were since a sample was used")
HAS_SPIKED: Final = LAYOUT.integer("has_spiked", "whether a signal jumped since then")
LAYOUT.integer("remembers", "1: what follows a gap depends on what was before it")
N_LATE: Final = LAYOUT.integer("n_late", "samples in a row whose stamp was no newer")
LAYOUT.integer("on_fault", "put out in doubt: 0 holds the correction, 1 measured, 2 NaN")
HAS_OUTPUT: Final = LAYOUT.integer("has_output", "whether a position was put out")
IS_DOUBTED: Final = LAYOUT.integer("is_doubted", "1: the last sample was not believed")
SUSPECT: Final = LAYOUT.integer("suspect", "status bit of a zero that may have moved")
ANCHOR: Final = LAYOUT.integer("anchor", "1: parity as it is now counts as right")
ROW: Final = LAYOUT.address("row", "the model's prediction")

T: Final = LAYOUT.scalar("t", "stamp of this sample [s]", is_time=True)
STAMP: Final = LAYOUT.scalar("stamp", "of the last sample with a usable one [s]", is_time=True)
LAST_T: Final = LAYOUT.scalar("last_t", "of the last sample that was used [s]", is_time=True)
PARITY_T: Final = LAYOUT.scalar("parity_t", "when parity last held [s]", is_time=True)
LAYOUT.scalar("patience", "for parity that does not hold [s]", is_time=True)
CHANGED_T: Final = LAYOUT.scalar("changed_t", "when a signal last changed [s]", is_time=True)
OUTPUT_T: Final = LAYOUT.scalar("output_t", "when a position was put out [s]", is_time=True)
DOUBTED_TIME: Final = LAYOUT.scalar("doubted_time", "since a sample was believed [s]", is_time=True)
LAYOUT.scalar("hold_time", "that a correction is held in doubt [s]", is_time=True)
LAYOUT.scalar("shortest", "time between two samples [s]", is_time=True)
LAYOUT.scalar(
    "slowest", "time between two samples of a loop that is as fast as the training", is_time=True
)
LATE: Final = LAYOUT.scalar("late", "share of the last samples that came later than that")
LAYOUT.scalar("longest", "that a history bridges [s]", is_time=True)
TRAINING_DT: Final = LAYOUT.scalar(
    "training_dt", "in which a signal may change by its reach [s]", is_time=True
)
LAYOUT.scalar("hold", "that all signals may stand still [s]", is_time=True)
LAYOUT.scalar("square", "largest square of the whitened features' length")
EXCESS: Final = LAYOUT.scalar("excess", "share of its range by which a feature lies outside")
LAYOUT.scalar("growth", "of the half-width outside the trained range")

LAYOUT.array("sample", "a number for each signal", "n_signals")
LAYOUT.array("last", "sample that was used", "n_signals")
LAYOUT.array("stood", "where a signal stands, since its last change", "n_signals")
LAYOUT.array("partner_low", "of the partner since the signal stands still", "n_signals")
LAYOUT.array("partner_high", "of the partner since the signal stands still", "n_signals")
LAYOUT.array("features", "of the last sample that was used", "n_features")
LAYOUT.array("centred", "features less their mean", "n_white")
LAYOUT.array("white", "features made uncorrelated", "n_white")
LAYOUT.array("reported", "measured position of this sample [rad or m]", "n_joints")
LAYOUT.array("position", "put out [rad or m]", "n_joints")
LAYOUT.array("applied", "correction in what is put out [rad or m]", "n_joints")
LAYOUT.array("rest", "of it, not yet that which is believed [rad or m]", "n_joints")
LAYOUT.array("return_speed", "of a correction after doubt [rad/s or m/s]", "n_joints")
LAYOUT.array("half_width", "put out [rad or m]", "n_joints")
LAYOUT.array("correction", "what the model says [rad or m]", "n_joints")
LAYOUT.array("offset", "added to the corrected positions [rad or m]", "n_joints")
LAYOUT.array("shift", "added to each signal: their zero has moved", "n_signals")
LAYOUT.array("added", "zero of the model, added to what it predicts [rad or m]", "n_joints")
LAYOUT.array("predicted", "position or error [rad or m]", "n_joints")
LAYOUT.array("predicted_width", "its half-width [rad or m]", "n_joints")
LAYOUT.array("base_width", "half-width within the trained range [rad or m]", "n_joints")
LAYOUT.array("feature_memory", "what the features remember", "n_feature_memory")
LAYOUT.array("clock", "whether the features saw a sample; its stamp [s]", 2, is_time=True)
LAYOUT.array("reach", "largest change of each signal within training_dt", "n_signals")
LAYOUT.array("jump", "largest change of each signal at once", "n_signals")
LAYOUT.array("spike", "of a signal that is too far: its last sample", "n_signals")
LAYOUT.array("spike_step", "of a signal that is too far: its last change", "n_signals")
LAYOUT.array("spike_peak", "of a signal that is too far: its largest change", "n_signals")
LAYOUT.array("flicker", "change below which a signal stands still", "n_signals")
LAYOUT.array("signal_lower", "below it a sample is not believed", "n_signals")
LAYOUT.array("signal_upper", "above it a sample is not believed", "n_signals")
LAYOUT.array("travel", "of the partner while a signal stands still", "n_signals")
LAYOUT.array("parity", "weight of each term in each equation", "n_parity", "n_terms")
LAYOUT.array("parity_intercept", "of each equation [rad or m]", "n_parity")
LAYOUT.array("parity_shift", "since then, that counts as right [rad or m]", "n_parity")
LAYOUT.array("parity_lower", "below it an equation does not hold", "n_parity")
LAYOUT.array("parity_upper", "above it an equation does not hold", "n_parity")
LAYOUT.array("parameter", "of each feature", "n_features")
LAYOUT.array("domain_mean", "of each feature in training", "n_features")
LAYOUT.array("feature_lower", "below it a feature is out of range", "n_features")
LAYOUT.array("feature_upper", "above it a feature is out of range", "n_features")
LAYOUT.array("trained_lower", "range of each feature in training", "n_features")
LAYOUT.array("trained_upper", "range of each feature in training", "n_features")
LAYOUT.array("per_span", "inverse length of that range", "n_features")
LAYOUT.array("correction_lower", "below it a correction is implausible", "n_joints")
LAYOUT.array("correction_upper", "above it a correction is implausible", "n_joints")
LAYOUT.array("whitening", "row i is what feature i adds to columns 0 to i", "n_white", "n_white")
LAYOUT.integers("spiked", "1: too far from the last used sample; 2: at once", "n_signals")
LAYOUT.integers("is_position_signal", "1 for measured positions", "n_signals")
LAYOUT.integers("parity_terms", "signal of each of these terms", "n_parity", "n_terms")
LAYOUT.integers("partner", "signal of the same channel; itself: none", "n_signals")
LAYOUT.integers("moves", "1 for signals that changed in training", "n_signals")
LAYOUT.integers("operation", "of each feature", "n_features")
LAYOUT.integers("source", "signal of each feature", "n_features")
LAYOUT.integers("slot", "of each feature in the features' memory", "n_features")
LAYOUT.integers("measured", "signal that is the joint's measured position", "n_joints")
MODEL: Final = LAYOUT.part("model", "the estimator")

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
    level = LEVEL if level is None else level
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
