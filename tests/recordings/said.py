"""A ROS on which a recording is said message by message, at the times of its stamps."""

from dataclasses import replace
from typing import Any

import numpy as np
from tests.local_ros import LocalRos
from tests.synthetic import build_recording

from truejoint.crtk.messages import JOINT_STATE, PROFILES, TRUTH_TOPIC, joint_state_fields
from truejoint.recordings import Recording

PROFILE = PROFILES["raven2_mended"]
STATE, SETPOINT = "/arm1/measured_js", "/arm1/setpoint_js"
TOPICS = {STATE: "measured", SETPOINT: "setpoint", TRUTH_TOPIC: "truth"}
START = 1.7e9


def told_session() -> Recording:
    """Half a minute of a RAVEN-II, with set-points."""
    whole = build_recording(900)
    names = [f"setpoint/{joint}" for joint in whole.robot.joint_names]
    moved = {n: whole.column(n.replace("setpoint", "measured")) for n in names}
    columns = {str(name): column.to_numpy() for name, column in whole.table.items()}
    origin = replace(whole.provenance, start=START)
    return Recording.from_columns({**columns, **moved}, origin)


class SaidRos(LocalRos):
    """Topics on which messages come `late` [s] after the time that they say that they are of."""

    def __init__(self) -> None:
        super().__init__()
        self.clock, self.late = START, 0.0
        for topic in TOPICS:
            self.publisher(topic, JOINT_STATE)

    def now(self) -> float:
        return self.clock

    def send(self, topic: str, message: Any) -> None:
        self.clock = max(self.clock, self.seconds(message) + self.late)
        super().send(topic, message)

    def say_all(self, recording: Recording, *, until: dict[str, float] | None = None) -> None:
        """Every row of a recording, on all topics; on some `until` a time [s] only."""
        columns = {str(name): c.to_numpy() for name, c in recording.table.items() if name != "t"}
        told = {
            topic: joint_state_fields(recording.robot, quantity, topic, columns, PROFILE)
            for topic, quantity in TOPICS.items()
        }
        for row, t in enumerate(recording.t.tolist()):
            for topic, (names, fields) in told.items():
                if t > (until or {}).get(topic, np.inf):
                    continue
                message = self.stamped(JOINT_STATE, START + t)
                message.name = list(names)
                for field, values in fields.items():
                    setattr(message, field, tuple(values[row].tolist()))
                self.send(topic, message)
