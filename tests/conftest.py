"""Fixtures that several packages share."""

import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Callable, Generator, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from tests.synthetic import build_recording, make_recording

from truejoint.crtk import Arm, OperatingState, StateBlock, TruthBlock
from truejoint.crtk.states import next_state
from truejoint.errors import RecordingError
from truejoint.recordings import Recording
from truejoint.recordings.datasets import locate
from truejoint.robots import get_robot
from truejoint.simulation import Twin, TwinOutput

# No example is a timing assertion: a first one compiles, and machines are busy. Examples are the
# same in every run, so that what fails has been changed; others are what `make fuzz` is for.
settings.register_profile(
    "steady",
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("steady")
os.fsync = lambda _file: None  # what tests write need outlive no power cut


LONGEST = (
    "estimators/test_contract", "crtk/backends/test_ros", "recordings/test_hostile",
    "tip/test_faults", "simulation/raven2/test_twin", "runtime/test_registered",
    "studies/forceps/test_experiments", "studies/raven2/test_experiments", "test_lab_day",
    "export/test_registered_c", "cli/test_dvrk", "test_first_hours", "calibration/test_truth_zero",
    "test_readme", "export/test_self_check", "calibration/test_cross_conformal",
    "calibration/test_choose", "test_examples", "estimators/network/test_sequence",
    "monitor/test_pages", "test_plugins", "cli/test_teleop", "recordings/judge/test_positions",
    "evaluation/test_evaluate", "evaluation/test_intervals",
)  # fmt: skip
"""Files that take longest. The first compiles the kernels and fits the models that others use.

Beside it run files that need few of them: what two processes lack at once, both compile.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files: no process has one left when the others are done."""
    turns = {Path(__file__).parent / f"{name}.py": turn for turn, name in enumerate(LONGEST)}
    items.sort(key=lambda item: turns.get(item.path, len(turns)))


def pytest_collection_finish() -> None:
    """Spare the garbage collector what stays to the end, and have it look less often.

    It looks for cycles alone; what none refers to goes at once all the same. Python's own threshold
    is some hundreds of objects, with which it looks while tables are read and pages written.
    """
    gc.freeze()
    gc.set_threshold(50_000)


def pytest_configure(config: pytest.Config) -> None:
    """Give the processes of a run one folder for models that any of them fits."""
    if "TRUEJOINT_TEST_MODELS" not in os.environ:
        folder = tempfile.mkdtemp(prefix="truejoint-models-")
        os.environ["TRUEJOINT_TEST_MODELS"] = folder
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


@pytest.fixture(autouse=True)
def _listening() -> Iterator[None]:
    """Ctrl-C is ignored in what a shell runs in the background: let tests of it be heard."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class LaggingBackend:
    """A RAVEN-II whose joints follow their set-points with a first-order lag, exactly.

    At a constant speed v the measured position is `lag * v` behind: a tracking error that a test
    can predict. Truth is the measured position at every tenth sample.
    """

    def __init__(self, lag: float, rate: float = 1000.0) -> None:
        self.rate, self.grain, self.stretch = rate, 0.01, 0.5
        self.robot = get_robot("raven2", "left")
        self.time = 0.0
        self.homing_id = "lagging"
        self.sent: list[np.ndarray] = []
        self.waited = 0.0
        self.state = OperatingState("DISABLED", is_homed=False, is_busy=False, t=0.0)
        self._decay = np.exp(-1.0 / (rate * lag))
        self._listener: Callable[[StateBlock | TruthBlock], None] = lambda block: None
        self._measured = self.robot.home.copy()

    def connect(self, listener: Callable[[StateBlock | TruthBlock], None]) -> None:
        self._listener = listener

    def disconnect(self) -> None:
        self._listener = lambda block: None

    def operating_state(self) -> OperatingState:
        return OperatingState(self.state.state, self.state.is_homed, self.state.is_busy, self.time)

    def state_command(self, command: str, timeout: float) -> None:
        self.state = next_state(self.state, command)
        if command == "home":
            self._measured = self.robot.home.copy()
            self._run(self.robot.home[None])

    def servo_jp(self, position: np.ndarray, go_on: Callable[[], bool]) -> int:
        if not go_on():
            return 0
        self.sent.append(position.copy())
        self._run(position)
        return len(position)

    def flush(self, timeout: float = 0.0, go_on: Callable[[], bool] = bool) -> str:
        return ""

    def wait(self, duration: float) -> None:
        self.time += duration
        self.waited += duration

    def _run(self, position: np.ndarray) -> None:
        measured = np.empty_like(position)
        for i, target in enumerate(position):
            self._measured = target + (self._measured - target) * self._decay
            measured[i] = self._measured
        t = self.time + 1.0 / self.rate * np.arange(1, len(position) + 1)
        self.time = float(t[-1])
        columns = [self.robot.channels.index(name) for name in self.robot.joint_names]
        arrays = np.zeros((2, len(position), len(self.robot.channels)))
        arrays[0][:, columns], arrays[1][:, columns] = position, measured
        zero = np.zeros_like(arrays[0])
        self._listener(
            StateBlock(t, self.robot.channels, arrays[1], zero, zero, arrays[0], zero, zero)
        )
        self._listener(TruthBlock(t[::10], self.robot.positioning, measured[::10, :3]))


@pytest.fixture
def lagging_backend() -> LaggingBackend:
    """Back end with a lag of 20 ms, disabled and not homed."""
    return LaggingBackend(0.02)


_HOMINGS: dict[str, tuple[list[TwinOutput], dict[str, Any]]] = {}


def _home_as_before(twin: Twin) -> None:
    """Let a twin that was just made home at once, if one just like it has homed: the same bits."""
    how = type(twin), twin.robot.title, twin.seed, twin.load, twin.time, twin.parameters
    key, homing = repr(how), twin.homing

    def homing_again() -> Generator[TwinOutput]:
        vars(twin).pop("homing")
        if key not in _HOMINGS:
            _HOMINGS[key] = list(homing()), deepcopy(vars(twin))
        pieces, after = _HOMINGS[key]
        kept = {"robot": twin.robot, "parameters": twin.parameters}
        vars(twin).update(deepcopy(after) | kept)
        yield from pieces

    vars(twin)["homing"] = homing_again


def homed(backend: Any) -> Arm:
    """Arm on a back end, enabled and homed."""
    twin = getattr(backend, "twin", None)
    if isinstance(twin, Twin) and twin.homing_count == 0 and "homing" not in vars(twin):
        _home_as_before(twin)
    arm = Arm(backend)
    arm.enable()
    arm.home()
    return arm


@pytest.fixture
def lagging_arm(lagging_backend: LaggingBackend) -> Arm:
    """Arm on `lagging_backend`, enabled and homed."""
    return homed(lagging_backend)


Build = Callable[..., Recording]


@pytest.fixture(name="build", scope="session")
def build_fixture() -> Build:
    return build_recording


@pytest.fixture(scope="session")
def recording_of() -> Build:
    return make_recording


@pytest.fixture(scope="session")
def recording() -> Recording:
    return build_recording()


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of few dots, not laid out, which takes long; a test of `figures` sees one whole."""
    monkeypatch.setattr("truejoint.drawing._DPI", 20)
    engine = "matplotlib.layout_engine.ConstrainedLayoutEngine"
    monkeypatch.setattr(f"{engine}.execute", lambda *_: None)


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Moves whose speed nobody gives are four times as fast, or more [rad/s, m/s]: less to wait."""
    for name, speed in (("POSITIONING", 0.2), ("TOOL", 2.0), ("PRISMATIC", 0.05)):
        monkeypatch.setattr(f"truejoint.crtk.limits._MOVE_{name}", speed)


@pytest.fixture
def dataset_folder() -> Callable[[str], Path]:
    """Folder of a public data set, or a skip that says why."""

    def find(name: str) -> Path:
        try:
            return locate(name)
        except RecordingError as error:
            pytest.skip(str(error))

    return find
