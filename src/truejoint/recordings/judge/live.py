"""What an arm says on a running ROS, kept for some seconds and judged as a recording of it is."""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, Final, Self

import numpy as np

from truejoint.array_types import Array
from truejoint.crtk.messages import ARMS, JOINT_STATE, OPERATING_STATES, USUAL_QUANTITIES
from truejoint.crtk.protocol import SILENCE
from truejoint.crtk.ros import Transport
from truejoint.errors import RecordingError
from truejoint.recordings.judge.data_check import DataCheck
from truejoint.recordings.judge.finding import Finding
from truejoint.recordings.judge.link import NO_STAMP, diagnose
from truejoint.recordings.read.bags import assembling
from truejoint.recordings.read.bags.fields import Lot
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots import get_robot

_PLACE: Final = "live"
_STEPS: Final = 10.0  # usual steps for which a slow topic may say nothing
_CLOCK: Final = 0.1  # [s] by which stamps may differ from this computer's clock
_SECOND: Final = 1e9  # ns
KEPT: Final = 100_000
"""Latest messages of a topic that are kept: 100 s at 1 kHz, some 100 MB of RAVEN-II's states."""

_Layout = tuple[tuple[str, ...], tuple[int, ...]]  # names in a message, and lengths of its lists


class LiveLink:
    """Keeps what is said on an arm's topics from entering to leaving, and judges it.

    Every joint state and every state of a RAVEN-II that somebody publishes is kept, as rosbag
    would, the latest `KEPT` of each topic; which of them are the arm's is told afterwards, as it is
    of a bag. The transport is one of `truejoint.crtk.open_transport`, the names are as `read_bag`
    takes them. Raises RecordingError on entering, listing all topics, if none is the arm's, and
    when it is judged if nothing came of one that is needed; RobotError if there is no such robot or
    profile; RosError if no master answers.
    """

    def __init__(
        self,
        transport: Transport,
        robot: str = "",
        arm: str = "",
        *,
        profile: str = "",
        state: str = "",
        truth: str = "",
    ) -> None:
        self._transport, self._robot, self._arm = transport, robot, arm
        self._how = {"profile": profile, "state": state, "truth": truth}
        self._heard: dict[str, Heard] = {}
        self._subscribed = ExitStack()

    def __enter__(self) -> Self:
        of_joints = (JOINT_STATE, *OPERATING_STATES)
        topics, raven = self._transport.topics(), assembling.RAVEN_TYPE
        kinds = {n: kind for n, kind in topics.items() if kind in of_joints or kind.endswith(raven)}
        if not kinds:
            raise RecordingError(
                f"{_PLACE}: nobody says anything of joints; start the robot's node"
            )
        self._expected = self._wire({name: (kind, 1) for name, kind in kinds.items()})
        for name, kind in kinds.items():
            self._heard[name] = Heard(name, kind)
            receive = partial(self._receive, self._heard[name])
            self._subscribed.callback(self._transport.subscribe(name, kind, receive))
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = self._transport.now()
        self._subscribed.close()

    def _receive(self, heard: "Heard", message: Any) -> None:
        heard.take(self._transport.now(), self._transport.seconds(message), message)

    def _wire(self, topics: assembling.Topics) -> assembling.Wiring:
        robot = assembling.robot_of(_PLACE, topics, self._robot, self._arm)
        return assembling.find_wiring(_PLACE, topics, robot, **self._how)

    def recordings(self) -> tuple[Recording, Recording | None]:
        """Make the recording of the arm, and of RAVEN-II that of the other arm meanwhile."""
        wiring = self._wiring()
        recording, robot = self._recording(wiring), wiring.robot
        if not self._heard[wiring.state].is_raven or robot.arm not in ARMS:
            return recording, None
        other = get_robot(robot.name, next(arm for arm in ARMS if arm != robot.arm))
        meanwhile = assembling.Wiring(other, wiring.state, profile=wiring.profile)
        return recording, self._recording(meanwhile)

    def diagnose(self) -> DataCheck:
        """Judge the link, and what came over it (`truejoint.recordings.diagnose`)."""
        heard = [self._heard[name] for name in self._wiring().joints]
        link = judge_link(heard, self._ended)
        return diagnose(*self.recordings()).with_findings([link])

    def _wiring(self) -> assembling.Wiring:
        self._heard[self._expected.state].check()
        return self._wire({n: (topic.kind, len(topic.times)) for n, topic in self._heard.items()})

    def _recording(self, wiring: assembling.Wiring) -> Recording:
        heard = [self._heard[name] for name in wiring.joints]
        lost = {f"{topic.name}: {NO_STAMP}": topic.invalid for topic in heard}
        robot = wiring.robot
        origin = Provenance(robot.name, robot.arm, source=_PLACE, session=_PLACE)
        homed = [self._heard[wiring.homed]] if wiring.homed else []
        lots = (lot for topic in (*heard, *homed) for lot in topic.lots())
        return assembling.assemble(lots, wiring, USUAL_QUANTITIES, origin, lost, _PLACE)


class Heard:
    """Messages of one topic as they come in, in a thread of ROS."""

    def __init__(self, name: str, kind: str) -> None:
        self.name, self.kind = name, kind
        self.is_raven = kind.endswith(assembling.RAVEN_TYPE)
        self.invalid = 0  # messages with a stamp of 0: CRTK says so that their values mean nothing
        self._fields = assembling.wanted_fields(kind, USUAL_QUANTITIES)
        self._lacking = ""
        self._rows: deque[tuple[float, float, _Layout, Array]] = deque(maxlen=KEPT)

    def take(self, arrival: float, stamp: float, message: Any) -> None:
        """Keep a message that came at `arrival` and says that it is of `stamp` [s]."""
        if not stamp > 0.0:
            self.invalid += 1
            return
        self._lacking = next((name for name in self._fields if not hasattr(message, name)), "")
        if self._lacking:
            return
        values = [np.atleast_1d(np.asarray(getattr(message, f), float)) for f in self._fields]
        layout = tuple(getattr(message, "name", ())), tuple(map(len, values))
        self._rows.append((arrival, stamp, layout, np.concatenate(values)))

    @property
    def times(self) -> Array:
        """When each message came, and of when it says that it is (n, 2) [s]."""
        return np.array([row[:2] for row in tuple(self._rows)]).reshape(-1, 2)

    def check(self) -> None:
        """Raise RecordingError where there is no message to be read."""
        if self._lacking:
            why = f"this version of {self.kind} has no field {self._lacking!r}"
        elif self.invalid:
            why = "its stamps are 0, which says that they mean nothing: is the robot homed?"
        else:
            why = "nothing came on it: is the robot homed, does its node run, and the network?"
        if not self._rows:
            raise RecordingError(f"{self.name}: {why}")

    def lots(self) -> Iterator[Lot]:
        """Messages, those with the same names and lengths together."""
        rows = tuple(self._rows)
        places: dict[_Layout, list[int]] = {}
        for place, (_, _, layout, _) in enumerate(rows):
            places.setdefault(layout, []).append(place)
        for (names, lengths), rows_alike in places.items():
            stamps = np.array([round(rows[place][1] * _SECOND) for place in rows_alike])
            table = np.stack([rows[place][3] for place in rows_alike])
            parts = np.split(table, np.cumsum(lengths)[:-1], axis=1)
            fields = dict(zip(self._fields, parts, strict=True))
            yield Lot(self.name, np.array(rows_alike), stamps, fields, {"name": names})


def judge_link(heard: Sequence[Heard], ended: float) -> Finding:
    """Judge how the messages of an arm's topics came in, until `ended` [s].

    It fails where one stopped, and warns where the first one's stamps are of another clock.
    """
    rates, stopped, late = [], [], 0.0
    for topic in heard:
        arrival, stamp = topic.times.T
        if len(arrival) < 2:
            stopped.append(f"{topic.name} said {'nothing' if not len(arrival) else 'one thing'}")
            continue
        step = np.diff(arrival)
        text = f"{topic.name} {1.0 / max(step.mean(), 1e-9):.4g} Hz"
        if topic is heard[0]:
            late, most = np.quantile(arrival - stamp, [0.5, 0.99])
            text += f", here {1e3 * late:.3g} ms after its stamp, 99 % within {1e3 * most:.3g} ms"
        rates.append(text)
        silent = ended - arrival[-1]
        if silent > max(SILENCE, _STEPS * float(np.median(step))):
            stopped.append(f"{topic.name} stopped {silent:.1f} s before the end")
    if stopped:
        return Finding("fail", "link", "; ".join([*stopped, *rates]), "")
    evidence = "; ".join(rates)
    if abs(late) > _CLOCK:
        advice = (
            "stamps and this computer's clock differ: keep the clocks of all computers together "
            "(chrony), or truth and state will not fit"
        )
        return Finding("warn", "link", evidence, "", advice)
    return Finding("good", "link", evidence, "")
