"""Tests of truejoint.crtk.backends.simulated."""

import numpy as np
import pytest
from tests.conftest import homed

from truejoint.crtk import Backend, SimulatedBackend, StateBlock, TruthBlock, simulated_arm
from truejoint.errors import CommandRefused, RobotError
from truejoint.recordings import Recorder
from truejoint.simulation import Twin, make_twin
from truejoint.simulation.raven2 import Raven2Twin
from truejoint.simulation.wrist.twin import WristTwin


@pytest.fixture
def backend() -> SimulatedBackend:
    return SimulatedBackend(Raven2Twin(arm="left", seed=1))


def record(arm):
    states: list[StateBlock] = []
    truths: list[TruthBlock] = []
    arm.subscribe(lambda b: (states if isinstance(b, StateBlock) else truths).append(b))
    return states, truths


def listen(backend, blocks):
    """Home a back end, and keep what it reports from then on."""
    backend.state_command("enable", 5.0)
    backend.state_command("home", 120.0)
    backend.connect(blocks.append)


def test_arm_reports_only_what_means_something(backend):
    typed: Backend = backend  # the type checker sees that it fits
    arm = simulated_arm("RAVEN2", "gold", seed=1)
    states, truths = record(arm)
    assert typed.robot.title == arm.robot.title == "raven2 (left arm)"
    arm.enable()
    arm.home()
    # Rows before the registration of the encoders are not positions.
    assert [len(block.t) for block in states] == [1]
    assert truths == []
    assert arm.measured_js().position[:3] == pytest.approx(arm.robot.home[:3], abs=0.02)
    assert arm.setpoint_js().position == pytest.approx(arm.robot.home)


def test_streams_agree_with_the_twin_itself(backend):
    twin, arm = backend.twin, homed(SimulatedBackend(make_twin(seed=1)))
    twin.home()
    states, truths = record(arm)
    path = arm.robot.home + np.linspace(0, 0.02, 500)[:, None] * np.array([1, 1, 0.1, 0, 0, 0, 0])
    arm.servo_jp_stream(path)
    output = twin.run(path)
    state, truth = StateBlock.joined(states), TruthBlock.joined(truths)
    for name in ("t", "measured", "velocity", "effort", "setpoint", "motor", "motor_velocity"):
        assert np.array_equal(getattr(state, name), getattr(output, name))
    assert np.array_equal(truth.t, output.truth.t)
    assert np.array_equal(truth.position, output.truth.position)
    assert arm.time == twin.time


def test_no_time_passes_once_it_is_not_to_go_on(backend):
    arm = homed(backend)
    start, rows = arm.time, np.tile(arm.robot.home, (500, 1))
    assert backend.servo_jp(rows, lambda: False) == 0
    assert arm.time == start
    assert backend.servo_jp(rows, lambda: True) == 500
    assert arm.time == pytest.approx(start + 0.5)


def test_an_arm_on_its_brakes_goes_on_to_report(backend):
    arm = homed(backend)
    arm.servo_jp_stream(arm.robot.home + np.linspace(0, 0.001, 100)[:, None])
    arm.pause()
    braked = arm.measured_js()
    assert braked.velocity.any()
    for command in ("pause", "disable"):
        arm.state_command(command)
        arm.wait(60.0)
        standing = arm.measured_js()
        assert standing.t == pytest.approx(arm.time, abs=2e-3)
        assert not standing.velocity.any()
        assert np.array_equal(standing.position, braked.position)
    arm.enable()
    assert arm.setpoint_js().t == standing.t
    arm.unhome()
    arm.wait(1.0)
    with pytest.raises(CommandRefused, match="not homed"):
        arm.measured_js()


def test_at_a_rate_of_its_own_a_set_point_holds_for_a_period():
    slow, fine = (SimulatedBackend(Raven2Twin(arm="left", seed=1), rate=r) for r in (500.0, 1e3))
    blocks = [[], []]
    for backend, said in zip((slow, fine), blocks, strict=True):
        listen(backend, said)
    rows = slow.robot.home + np.linspace(0, 0.001, 100)[:, None]
    assert slow.servo_jp(rows, lambda: True) == 100
    fine.servo_jp(np.repeat(rows, 2, axis=0), lambda: True)
    assert slow.time == fine.time
    ours, theirs = (StateBlock.joined([b for b in s[1:] if hasattr(b, "t")][:1]) for s in blocks)
    for quantity in ("t", "measured", "effort", "setpoint"):
        assert np.array_equal(getattr(ours, quantity), getattr(theirs, quantity)[1::2])
    assert np.array_equal(blocks[0][2].position, blocks[1][2].position)  # all readings


@pytest.mark.parametrize("rate", [0.0, -500.0, 300.0, 2000.0, np.nan, np.inf])
def test_a_twin_takes_no_rate_that_does_not_divide_its_own(backend, rate):
    with pytest.raises(RobotError, match="a twin runs at 1000 Hz"):
        SimulatedBackend(backend.twin, rate=rate)


@pytest.mark.parametrize("name", ["raven2", "forceps", "wrist"])
def test_a_leap_that_is_stopped_in_the_middle_is_taken_back(name):
    backends = [SimulatedBackend(make_twin(name, seed=4)) for _ in range(2)]
    heard = [[], []]
    for backend, blocks in zip(backends, heard, strict=True):
        listen(backend, blocks)
        assert blocks.pop().t[-1] == pytest.approx(backend.time, abs=2e-3)  # where the arm is
    stopped, undisturbed = backends
    rows = np.tile(stopped.robot.home, (400, 1)) + 1e-4 * np.sin(np.arange(400.0) / 50)[:, None]
    before = stopped.time
    answers = iter([True, False])  # goes on before the leap, not after it
    assert stopped.servo_jp(rows, lambda: next(answers)) == 0
    assert stopped.time == before
    assert heard[0] == []
    for backend in backends:  # and nothing of it is left
        assert backend.servo_jp(rows, lambda: True) == 400
    ours, theirs = (blocks[0] for blocks in heard)
    for quantity in ("t", "measured", "effort", "motor", "joint"):
        assert np.array_equal(getattr(ours, quantity), getattr(theirs, quantity))
    assert np.array_equal(ours.truth.position, theirs.truth.position)
    assert stopped.time == undisturbed.time == pytest.approx(before + 0.4)


def test_a_load_that_is_hung_on_during_a_leap_stays():
    backend = SimulatedBackend(make_twin("raven2", seed=4))
    listen(backend, [])
    run = backend.twin.run

    def hung(rows):
        backend.twin.load = 0.3
        return run(rows)

    backend.twin.run = hung
    answers = iter([True, False])
    backend.servo_jp(np.tile(backend.robot.home, (400, 1)), lambda: next(answers))
    assert backend.twin.load == 0.3


def test_what_a_twin_alone_reports_is_recorded_with_its_units():
    twin: Twin = WristTwin(seed=3, load=0.2)
    arm = homed(SimulatedBackend(twin))
    with Recorder(arm, state_rate=100.0) as recorder:
        arm.wait(0.5)
        twin.load = 0.0
        arm.wait(0.5)
    recording = recorder.recording()
    assert recording.provenance.homing_id == "seed 3, homing 1"
    assert recording.units["truth_load/grip"] == "Nm"
    pitch = recording.column("truth_load/pitch")[[0, -1]]
    assert pitch == pytest.approx([-0.2 * 9.81 * 19e-3, 0.0])
    assert recording.joints_of("truth") == arm.robot.positioning
    assert recording.joints_of("effort") == arm.robot.channels


def test_a_command_out_of_turn_is_refused():
    with pytest.raises(CommandRefused, match="'resume' refused"):
        simulated_arm().resume()
