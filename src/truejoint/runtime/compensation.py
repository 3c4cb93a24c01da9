"""One step of the compensator: from where the joints are wanted to set-points of the motors."""

from math import isfinite, isnan, nan
from typing import Final

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled
from truejoint.layout import Layout

LAYOUT: Final = Layout().declare(__package__, "compensator")
STATUS, KNOWS_LOST, FALLS_BACK, GAIN, TRUST, WEIGHT = LAYOUT.places(
    "status knows_lost falls_back gain trust weight"
)

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
    # A message that came again, which is OK without a correction, tells nothing.
    if believed or (m.status != 0 and (moves or (m.status & m.doubted) != m.still)):
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
