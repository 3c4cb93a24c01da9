"""One step of the compensator: from where the joints are wanted to set-points of the motors."""

from __future__ import annotations

from math import isfinite, isnan, nan
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.layout import Layout

LAYOUT: Final = Layout()
LAYOUT.integer("n_joints", "that are compensated")
STATUS: Final = LAYOUT.integer("status", "bits that the corrector gave for this sample")
LAYOUT.integer("doubted", "bits with which a sample is not believed")
KNOWS_LOST: Final = LAYOUT.integer("knows_lost", "whether a sample was believed")
LAYOUT.integer("still", "bits that do not count where nothing is wanted to move")
FALLS_BACK: Final = LAYOUT.integer("falls_back", "whether nothing is fed back for want of trust")

LAYOUT.scalar("lead", "steps by which set-points are ahead of what is wanted")
GAIN: Final = LAYOUT.scalar("gain", "share of the remaining error that is added")
LAYOUT.scalar("share", "of the low-pass of what is lost, a step")
LAYOUT.scalar("integral", "share of the remaining error made up for, a step")
LAYOUT.scalar("settle", "share of the way that is gone a step, standing still")
LAYOUT.scalar("dead_band", "error let be where a joint stands still [rad or m]")
LAYOUT.scalar("forget", "share of a low-pass of a second, a step")
TRUST: Final = LAYOUT.scalar("trust", "share of steps that were believed, low-passed")
WEIGHT: Final = LAYOUT.scalar("weight", "of gain and share, less than 1 after a fall-back")

LAYOUT.array("wanted", "at the next step [rad or m]", "n_joints")
LAYOUT.array("measured", "of this sample [rad or m]", "n_joints")
LAYOUT.array("correction", "true less measured, as the model says [rad or m]", "n_joints")
LAYOUT.array("setpoint", "put out [rad or m]", "n_joints")
LAYOUT.array("last_wanted", "one step before; NaN at first [rad or m]", "n_joints")
LAYOUT.array("lost", "correction, low-passed [rad or m]", "n_joints")
LAYOUT.array("made_up", "of the error that remained [rad or m]", "n_joints")
LAYOUT.array("lower", "limit of the set-point [rad or m]", "n_joints")
LAYOUT.array("upper", "limit of the set-point [rad or m]", "n_joints")
LAYOUT.array("step", "longest step of the set-point [rad or m]", "n_joints")
LAYOUT.integers("is_limited", "1 where a limit held the set-point back", "n_joints")
LAYOUT.integers("rests", "1 where a joint stands within the dead band", "n_joints")

LEAST_TRUST: Final = 0.5
"""Share of steps that must be believed, or the compensator falls back."""
ENOUGH_TRUST: Final = 0.75
"""Share of steps with which it feeds back again."""

unpack = LAYOUT.unpacker()


@compiled
def begin(numbers: Integers, memory: Array) -> None:
    """Begin at rest from the set-points in the memory."""
    m = unpack(numbers, memory)
    numbers[KNOWS_LOST] = 0
    numbers[FALLS_BACK] = 0
    memory[TRUST] = 1.0
    memory[WEIGHT] = 1.0
    for k in range(m.n_joints):
        m.last_wanted[k] = nan
        m.lost[k] = 0.0
        m.made_up[k] = 0.0
        m.is_limited[k] = 0
        m.rests[k] = 0


@compiled
def compensate(numbers: Integers, memory: Array) -> None:
    """Take a step: reads what is wanted, measured and corrected, and changes the set-points."""
    m = unpack(numbers, memory)
    known = int(numbers[KNOWS_LOST])
    believed = bool((m.status & m.doubted) == 0)
    for k in range(m.n_joints):
        if not isfinite(m.correction[k]):
            believed = False
    if believed and not m.falls_back:
        numbers[KNOWS_LOST] = 1
    moves = False
    for k in range(m.n_joints):
        wanted, last = m.wanted[k], m.last_wanted[k]
        before = wanted if isnan(last) else last
        goal = wanted if isfinite(wanted) else before
        if isfinite(goal):
            moves = moves or goal != before
            fed_back = 0.0
            if m.falls_back:
                m.made_up[k] -= m.forget * m.made_up[k]
            elif believed:
                fed_back = feed_back(numbers, memory, k, known, before, goal)
            ahead = goal + m.lead * (goal - before) + fed_back
            go_on(numbers, memory, k, before, goal, ahead)
    if believed or moves or (m.status & m.doubted) != m.still:
        judge(numbers, memory, 1.0 if believed else 0.0)


@compiled
def judge(numbers: Integers, memory: Array, believed: float) -> None:
    """Count a step that was `believed`, 1, or not, 0, and fall back or go on by the share."""
    m = unpack(numbers, memory)
    trust = m.trust + m.forget * (believed - m.trust)
    memory[TRUST] = trust
    if trust < LEAST_TRUST:
        numbers[FALLS_BACK] = 1
    elif trust > ENOUGH_TRUST:
        numbers[FALLS_BACK] = 0
    grown = m.weight + m.forget * (1.0 - m.weight)
    memory[WEIGHT] = 0.0 if numbers[FALLS_BACK] else grown


@compiled
def feed_back(
    numbers: Integers, memory: Array, k: int, known: int, before: float, goal: float
) -> float:
    """Learn what joint `k` loses, and give the share of its error that is added at once."""
    m = unpack(numbers, memory)
    missing = before - m.measured[k] - m.correction[k]
    is_near = abs(missing) < m.dead_band
    if known == 0:
        m.lost[k] = m.correction[k]
        if m.integral > 0.0:  # the first set-point is that which is there
            m.made_up[k] = m.setpoint[k] - before + m.correction[k]
    else:
        m.lost[k] = m.lost[k] + m.share * m.weight * (m.correction[k] - m.lost[k])
        if m.is_limited[k] == 0 and not is_near:
            m.made_up[k] += m.integral * missing
    m.rests[k] = 1 if goal == before and is_near else 0
    return float(m.gain * m.weight * missing)


@compiled
def go_on(
    numbers: Integers, memory: Array, k: int, before: float, goal: float, ahead: float
) -> None:
    """Move the set-point of joint `k`, within its limits."""
    m = unpack(numbers, memory)
    setpoint, longest = m.setpoint[k], m.step[k]
    asked = ahead + m.made_up[k] - m.lost[k]
    if m.knows_lost == 0:
        asked = setpoint + goal - before
    elif goal == before:
        way = 0.0 if m.rests[k] else m.settle * (asked - setpoint)
        asked = setpoint + way
    else:
        m.rests[k] = 0
    limited = min(max(asked, setpoint - longest), setpoint + longest)
    limited = min(max(limited, m.lower[k]), m.upper[k])
    m.is_limited[k] = 1 if limited != asked else 0
    m.setpoint[k] = limited
    m.last_wanted[k] = goal
