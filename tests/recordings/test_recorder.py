import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.crtk import StateBlock, TruthBlock, simulated_arm
from truejoint.recordings import Recorder, read_recording
from truejoint.recordings.recorder import PAST_END, REHOMED, Decimator
from truejoint.recordings.table.stream import AFTER, BACK, Stream
from truejoint.robots import get_robot
from truejoint.robots.blocks import QUANTITIES


class FakeArm:
    """Reports what a test tells it to."""

    def __init__(self) -> None:
        self.robot = get_robot("raven2", "right")
        self.homing_id, self.stretch = "", 0.5
        self.listeners: list[Callable[..., None]] = []

    def subscribe(self, callback: Callable[..., None], every: float = 0.0) -> None:
        self.listeners.append(callback)

    def unsubscribe(self, callback: Callable[..., None]) -> None:
        self.listeners.remove(callback)

    def deliver(self, callback: Callable[..., None]) -> None:
        """Keeps nothing."""

    def state(self, t: np.ndarray) -> None:
        """Report rows whose values tell quantity, channel and time."""
        arrays = {
            quantity: 100.0 * k + np.arange(8.0)[None, :] + 1e-3 * t[:, None]
            for k, quantity in enumerate(QUANTITIES)
        }
        for listener in self.listeners:
            listener(StateBlock(t=t, name=self.robot.channels, **arrays))

    def truth(self, t: np.ndarray) -> None:
        for listener in self.listeners:
            listener(TruthBlock(t, self.robot.positioning, np.column_stack([t, 2 * t, 3 * t])))


@pytest.fixture
def arm() -> Any:
    return FakeArm()


def test_records_every_channel_at_its_rate(arm):
    with Recorder(arm, session="s", homing_id="h", load=0.5, command="c") as recorder:
        for start in range(0, 3000, 500):
            arm.state(np.arange(start, start + 500) * 1e-3)
            arm.truth(np.arange(start, start + 500, 10) * 1e-3)
    recording = recorder.recording()
    assert np.median(np.diff(recording.t)) == pytest.approx(1 / 30, abs=1e-3)
    assert len(recording) == 90
    for k, quantity in enumerate(QUANTITIES):
        for i, channel in enumerate(arm.robot.channels):
            expected = 100 * k + i + 1e-3 * recording.t
            assert np.allclose(recording.column(f"{quantity}/{channel}"), expected)
    known = recording.t <= 2.99
    truth = recording.columns("truth", arm.robot.positioning)
    assert np.allclose(truth[known], recording.t[known, None] * [1, 2, 3])
    provenance = recording.provenance
    assert (provenance.robot, provenance.arm) == ("raven2", "right")
    assert (provenance.session, provenance.homing_id, provenance.command) == ("s", "h", "c")
    assert provenance.load == 0.5
    assert provenance.rates == {"state": 30.0, "truth": 100.0}
    assert recording.units["effort/insertion"] == "Nm"
    assert not arm.listeners


@given(
    cuts=st.lists(st.integers(0, 400), max_size=8),
    rate=st.sampled_from([7.0, 30.0, 100.0, 333.3, 1000.0, 5000.0]),
    jitter=st.floats(0, 0.4),
)
def test_the_rows_kept_do_not_depend_on_the_pieces(cuts, rate, jitter):
    rng = np.random.default_rng(1)
    t = (np.arange(400) + jitter * rng.uniform(-1, 1, 400)) * 1e-3 + 12.3456
    whole = Decimator(rate).pick(t)
    pieces = Decimator(rate)
    parts = [pieces.pick(piece) for piece in np.split(t, sorted(cuts))]
    assert np.array_equal(whole, np.concatenate(parts))
    assert whole[0]
    assert whole.sum() <= np.ceil((t[-1] - t[0]) * rate) + 1
    if rate <= 250:
        assert np.diff(t[whole]).max() < 1 / rate + 2e-3
    if rate >= 5000:
        assert whole.all()
    assert Decimator(rate).pick(3.0 + np.arange(300) / rate).all()  # each begins a cell


def test_an_interrupt_keeps_and_writes_what_there_is(arm, tmp_path):
    path = tmp_path / "run.parquet"
    recorder = Recorder(arm, path=path)

    def move() -> None:
        with recorder:
            arm.state(np.arange(1000) * 1e-3)
            arm.truth(np.arange(50) * 1e-2)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        move()
    assert not arm.listeners
    assert recorder.written == tmp_path / "run.unfinished.stream"
    assert not path.exists()
    written = read_recording(recorder.written)
    assert written.provenance.notes == "stopped by KeyboardInterrupt"
    assert len(written) == len(recorder.recording()) == 30
    assert written.provenance.dropped[AFTER] == np.isnan(written.column("truth/elbow")).sum() > 0


def test_a_file_that_is_there_is_refused_before_the_arm_moves(arm, tmp_path):
    path = tmp_path / "run.parquet"
    path.touch()
    refused("exists already", Recorder, arm, path=path)


def test_a_recording_whose_name_was_taken_meanwhile_is_kept(arm, tmp_path):
    path = tmp_path / "run.parquet"
    recorder = Recorder(arm, path=path)

    def move() -> None:
        with recorder:
            arm.state(np.arange(1000) * 1e-3)
            path.write_text("theirs")

    refused(r"exists already.*the recording is in .*run\.unfinished\.stream", move)
    assert path.read_text() == "theirs"
    assert recorder.written == tmp_path / "run.unfinished.stream"
    kept = read_recording(recorder.written)
    assert not kept.provenance.notes
    pd.testing.assert_frame_equal(kept.table, recorder.recording().table)


def test_truth_may_come_from_sensors_of_their_own(arm):
    class Sensors:
        def subscribe(self, callback: Callable[..., None]) -> None:
            self.tell = callback

        def unsubscribe(self, callback: Callable[..., None]) -> None:
            del self.tell

    sensors = Sensors()
    with Recorder(arm, truth=sensors) as recorder:
        arm.state(np.arange(1000) * 1e-3)
        arm.truth(np.arange(100) * 1e-2)  # of its own, which is left alone
        t = np.arange(120) * 1e-2
        sensors.tell(TruthBlock(t, ("elbow",), 0.5 * t[:, None]))
    recording = recorder.recording()
    assert recording.joints_of("truth") == ("elbow",)
    assert recording.column("truth/elbow") == pytest.approx(0.5 * recording.column("t"))
    assert not hasattr(sensors, "tell")


def test_what_is_recorded_is_on_disk_meanwhile(arm, tmp_path):
    with Recorder(arm, path=tmp_path / "run.parquet", load=0.1, session="a run") as recorder:
        arm.state(np.arange(1000) * 1e-3)
        arm.truth(np.arange(50) * 1e-2)
        arm.state(1.0 + np.arange(1000) * 1e-3)
        # What a program that is killed now leaves.
        left = read_recording(tmp_path / "run.unfinished.stream")
        now = recorder.recording()
    pd.testing.assert_frame_equal(left.table, now.table)
    assert left.provenance.session == "a run"
    assert left.provenance.load == 0.1
    assert left.provenance.rates == now.provenance.rates
    assert left.provenance.notes == "cut short while it was recorded"
    assert recorder.written == tmp_path / "run.parquet"
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet"]


def test_a_clock_that_is_set_back_is_counted(arm):
    with Recorder(arm, state_rate=1000.0) as recorder:
        arm.state(np.arange(100) * 1e-3)
        arm.state(np.arange(100) * 1e-3 + 0.05)
    recording = recorder.recording()
    assert recording.provenance.dropped == {f"state: {BACK}": 50}
    assert recording.joints_of("truth") == ()
    assert len(recording) == 150


def test_what_comes_after_the_longest_duration_is_counted(arm, monkeypatch):
    monkeypatch.setattr("truejoint.recordings.recorder.LONGEST", 1.0)
    with Recorder(arm, state_rate=10.0) as recorder:
        for second in range(5):
            arm.state(second + np.arange(1000) * 1e-3)
            arm.truth(second + np.arange(100) * 1e-2)
    recording = recorder.recording()
    assert recording.duration == pytest.approx(1.0, abs=0.01)
    assert len(recording) + recording.provenance.dropped[PAST_END] == 50


def test_an_arm_that_reports_nothing_is_named_and_leaves_no_file(arm, tmp_path):
    recorder = Recorder(arm, path=tmp_path / "run.parquet", overwrite=True)
    with recorder:
        arm.state(np.arange(1000) * 1e-3)
    with recorder:  # which begins anew
        pass
    refused(r"from raven2 \(right arm\): 0 rows", recorder.recording)
    assert [path.name for path in tmp_path.iterdir()] == ["run.parquet"]


@pytest.mark.parametrize("options", [{"gap_limit": 0.0}, {"state_rate": 0.0}])
def test_settings_are_checked(arm, options):
    refused("above 0", Recorder, arm, **options)


def test_records_the_simulated_arm():
    arm = simulated_arm(seed=3)
    arm.enable()
    arm.home()
    with Recorder(arm) as recorder:
        arm.wait(2.0)
    recording = recorder.recording()
    assert len(recording) == pytest.approx(60, abs=1)
    with Recorder(arm, state_rate=math.inf) as every:
        for _ in range(3):
            arm.wait(0.1)
            amid = every.recording()  # of all that came
            assert amid.provenance.start + amid.t[-1] == pytest.approx(arm.time, abs=2e-3)
    assert amid.provenance.rates["state"] == pytest.approx(1000.0)
    assert recording.joints_of("truth") == arm.robot.positioning
    # Within the coarse bounds of an arm that is not calibrated.
    assert (np.abs(recording.with_truth(arm.robot.positioning).error(["shoulder"])) < 0.3).all()


@pytest.mark.parametrize("first", ["", "homed at 1.000"])
def test_a_recording_is_of_one_homing_that_of_its_first_row(arm, caplog, first):
    with Recorder(arm, state_rate=math.inf) as recorder:
        arm.homing_id = first  # while it was waited for
        arm.state(np.arange(0, 50) * 1e-3)
        arm.homing_id = "homed at 60.000"
        for start in (60.0, 61.0):
            arm.state(start + np.arange(0, 50) * 1e-3)
    recording = recorder.recording()
    assert (len(recording), recording.provenance.homing_id) == (50, first)
    assert recording.provenance.dropped == {REHOMED: 100}
    assert caplog.messages == ["the arm was homed again: record what follows by itself"]


def test_a_forceps_is_recorded_with_all_that_its_twin_reads():
    arm = simulated_arm("forceps", seed=3)
    arm.enable()
    arm.home()
    with Recorder(arm, state_rate=200.0) as recorder:
        arm.wait(0.1)
    recording = recorder.recording()
    assert recording.provenance.homing_id == "seed 3, homing 1"
    assert recording.units["cable/reset"] == "m"
    assert recording.units["truth_load/jaw"] == "Nm"
    assert recording.units["truth_tension/drive"] == "N"
    assert not recording.joints_of("effort")


def test_what_comes_while_rows_are_joined_waits_for_the_next_time(arm):
    class Growing(list[Stream]):
        def __iter__(self) -> Iterator[Stream]:
            yield from [self[k] for k in range(len(self))]
            self.append(Stream(self[-1].t + 1.0, self[-1].columns))

    recorder = Recorder(arm)
    pieces = Growing([Stream(np.array([1.0, 1.1]), {"measured/jaw1": np.array([0.1, 0.2])})])
    recorder._pieces["state"] = pieces
    assert recorder.recording().t.tolist() == pytest.approx([0.0, 0.1])
    assert len(pieces) == 2
