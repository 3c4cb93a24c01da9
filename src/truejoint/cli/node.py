"""`truejoint node`: correct, simulate and record an arm on the topics of a running ROS."""

import logging
import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import truejoint
from truejoint.cli import options
from truejoint.cli.console import command_line, out, say
from truejoint.cli.recording_options import as_provenance, parse_metadata
from truejoint.errors import RosError, TruejointError
from truejoint.files import check_target
from truejoint.robots.catalogue import DEFAULT
from truejoint.threads import short_turns

if TYPE_CHECKING:
    from truejoint.crtk.ros import Transport


_LOOK: Final = 0.2  # [s] between two looks at whether to end
_MENDED: Final = "raven2_mended"


@dataclass(frozen=True)
class Link:
    """How and for how long topics are taken part in, an option each."""

    namespace: str = ""
    duration_s: float = math.inf
    ros: int = 1


def correct(
    model: Path,
    link: Link,
    profile: str = "",
    level_percent: float | None = None,
    homing_id: str | None = None,
    on_fault: Literal["hold", "raw", "silent"] = "hold",
) -> None:
    """Correct an arm's joints as they come.

    In <namespace>/corrected: measured_js, half_width and status; once a second /diagnostics.
    """
    from truejoint.runtime.node import CorrectorNode

    level = options.share(level_percent)
    with as_node("truejoint_correct", link.ros) as transport:
        calibration = truejoint.read_calibration(model)
        others = [calibration.without_redundant()] if calibration.redundant else []
        correctors = [
            truejoint.runtime.Corrector(choice, level=level, on_fault=on_fault)
            for choice in (calibration, *others)
        ]
        node = CorrectorNode(
            transport, correctors, calibration.machine, profile,
            namespace=link.namespace, homing_id=homing_id, say=say,
        )  # fmt: skip
        with node, suppress(KeyboardInterrupt):
            node.run(link.duration_s)
        out.print(f"{node.received} messages, {node.corrected} corrected")


def simulate(
    link: Link,
    robot: str = DEFAULT,
    seed: int = 0,
    twin: str = "nominal",
    load_grams: float = 0.0,
    quirks: bool = False,
    homed: bool = False,
    state_rate_hz: float = 1e3,
) -> None:
    """Stand in for a robot: a digital twin in real time on CRTK's topics and RAVEN-II's."""
    from truejoint.crtk.server import ArmServer

    made = options.make_twin(robot, parameters=twin, seed=seed, load=load_grams / 1e3)
    if quirks and made.robot.name != DEFAULT:
        raise RosError(f"--quirks are those of {DEFAULT}; leave it out for {made.robot.name}")
    profile = _MENDED if made.robot.name == DEFAULT and not quirks else ""
    say(f"{made.robot.title}: getting ready; the first time its kernels are compiled")
    with (
        as_node("truejoint_simulate", link.ros) as transport,
        truejoint.crtk.Arm(truejoint.crtk.PacedBackend(made, homed=homed)) as device,
        ArmServer(
            device, transport, profile, namespace=link.namespace, rate=state_rate_hz
        ) as server,
    ):
        say(f"{device.robot.title}, simulated, on {', '.join(server.topics)}")
        wait(transport, link.duration_s)


def record(
    output: Path,
    link: Link,
    robot: str = DEFAULT,
    profile: str = "",
    truth: str = "",
    beside: list[str] | None = None,
    state_rate_hz: float = 100.0,
    metadata: list[str] | None = None,
    force: bool = False,
) -> None:
    """Record what an arm reports while others move it; no command is sent."""
    check_target(output, overwrite=force)
    about: dict[str, Any] = {"session": output.stem, "load": math.nan}
    about |= as_provenance(parse_metadata(metadata))
    with as_node("truejoint_record", link.ros) as transport:
        target = options.get_robot(robot)
        backend = truejoint.crtk.RosBackend(
            transport, target, profile, namespace=link.namespace, truth=truth, beside=beside or ()
        )
        with truejoint.crtk.Arm(backend, controls=False) as device:
            recorder = truejoint.recordings.Recorder(
                device, state_rate=state_rate_hz, path=output, overwrite=force,
                command=command_line(), **about,
            )  # fmt: skip
            with recorder, suppress(KeyboardInterrupt):
                if not device.operating_state().is_homed:
                    say(f"waiting for {target.title} to be homed")
                wait(transport, link.duration_s, lambda: _listen(device))
        if recorder.written is None:
            raise RosError(f"{output}: fewer than two states came in time; is the arm homed?")
        out.print(f"{recorder.written}: {recorder.rows} rows")


def encoders(port: str, link: Link, robot: str = DEFAULT, profile: str = "") -> None:
    """Publish temporary joint encoders as RAVEN-II's do, registered while the arm homes."""
    from truejoint.recordings.joint_encoders import EncoderNode, JointEncoders

    target = options.get_robot(robot)
    with as_node("truejoint_encoders", link.ros) as transport:
        line = JointEncoders(port, target.encoders, clock=transport.now)
        node = EncoderNode(transport, line, target, profile, namespace=link.namespace, say=say)
        with node, suppress(KeyboardInterrupt):
            wait(transport, link.duration_s)
        out.print(f"{node.published} messages, {line.garbage} lines of garbage")


def _listen(arm: "truejoint.crtk.Arm") -> None:
    """Raise CommandRefused if a homed arm does not report."""
    from truejoint.crtk.protocol import SILENCE

    if arm.operating_state().is_homed:
        arm.measured_js(SILENCE)


@contextmanager
def as_node(name: str, ros: int) -> "Iterator[Transport]":
    """Be a node of ROS until Ctrl-C, which is how a node ends."""
    try:
        with joined(name, ros) as transport:
            yield transport
    except KeyboardInterrupt:
        say("stopped")


@contextmanager
def joined(name: str, ros: int) -> "Iterator[Transport]":
    """Be a node of ROS meanwhile; what parts of it have to say goes to the person."""
    from truejoint.crtk.ros import open_transport

    transport = open_transport(ros, name)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does
    log = logging.getLogger("truejoint")
    handler, propagated = _Sayer(), log.propagate
    log.addHandler(handler)
    log.propagate = False
    try:
        with short_turns():
            yield transport
    finally:
        transport.close()
        log.removeHandler(handler)
        log.propagate = propagated
        signal.signal(signal.SIGTERM, before)


class _Sayer(logging.Handler):
    """Tells the person what is logged, no line twice in a second."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._said: dict[str, float] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Say a line."""
        text, now = record.getMessage(), time.monotonic()
        if now - self._said.get(record.msg, -math.inf) > 1.0:
            self._said[record.msg] = now
            say(text)


def wait(transport: "Transport", seconds: float, look: Callable[[], object] = lambda: None) -> None:
    """Let time pass until it is over or the node is shut down, looking at something meanwhile."""
    end = time.monotonic() + seconds
    while not transport.is_over and (remaining_s := end - time.monotonic()) > 0.0:
        try:
            look()
        except TruejointError as error:
            logging.getLogger("truejoint").warning("%s", error)
        time.sleep(min(_LOOK, remaining_s))
