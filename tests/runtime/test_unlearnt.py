"""Motion unlike that of the training is named, and corrected all the same."""

from dataclasses import replace

import numpy as np
import pytest

from truejoint.recordings import Provenance, Recording
from truejoint.runtime import Unlearnt

from .streams import MINUTE, ready, stream, trained


def swings(middle, amplitude, t=MINUTE):
    """Signals (n, 4) of both joints on sines between the same points."""
    q = middle + amplitude * np.sin(1.1 * t)
    noise = np.random.default_rng(1).uniform(-0.02, 0.02, (len(t), 2))
    effort = 0.4 * np.cos(3.0 * q)
    return np.column_stack([q, effort + noise[:, 0], q, effort + noise[:, 1]])


def about_the_middle(amplitude):
    """Recording with truth of such swings about 0.5."""
    samples = swings(0.5, amplitude)
    names = ("measured/shoulder", "effort/shoulder", "measured/elbow", "effort/elbow")
    columns = {"t": MINUTE} | dict(zip(names, samples.T, strict=True))
    columns |= {f"truth/{j}": 1.01 * samples[:, 0] for j in ("shoulder", "elbow")}
    origin = Provenance("raven2", arm="left", source=f"{amplitude}", homing_id="h1")
    return Recording.from_columns(columns, origin, dict.fromkeys(names[1::2], "Nm"))


def shares(corrector, t, samples):
    """Share of the samples with each warning, and of those that are corrected."""
    warned, good = [], []
    for stamp, sample in zip(t.tolist(), samples, strict=True):
        good.append(corrector.step(stamp, sample) == 0)
        warned.append(int(corrector.unlearnt))
    bits = np.array(warned)
    return {w: float(np.mean(bits & w != 0)) for w in Unlearnt}, float(np.mean(good))


@pytest.fixture(scope="module")
def model():
    return trained()


@pytest.mark.parametrize("rate", [30, 1000])
@pytest.mark.parametrize(
    ("speed", "warning"), [(1.0, None), (2.0, Unlearnt.FASTER), (0.5, Unlearnt.SLOWER)]
)
def test_other_rates_of_motion_are_named_at_any_sampling_rate(model, rate, speed, warning):
    t = np.arange(0.0, 30.0, 1 / rate)
    warned, good = shares(ready(model), t, stream(7.0 + speed * t, seed=3))
    assert good == 1.0
    if warning is None:
        assert max(warned.values()) == 0.0
    else:
        assert warned[warning] > 0.5
        assert warned[Unlearnt(3) ^ warning] == 0.0


def test_swings_that_begin_at_an_end_are_named_where_all_were_about_the_middle():
    training = [about_the_middle(amplitude) for amplitude in (0.06, 0.12, 0.18, 0.24)]
    corrector = ready(trained(recordings=training))
    for amplitude in (0.15, 0.21):
        warned, good = shares(corrector, MINUTE, swings(0.5, amplitude))
        assert warned[Unlearnt.SWING] <= 0.5
        assert good == 1.0
        corrector.set_homing(False)
        corrector.set_homing(True, "h1")
    for amplitude in (0.05, 0.1):
        fresh = ready(trained(recordings=training))
        warned, good = shares(fresh, MINUTE, swings(0.26 + amplitude, amplitude))
        assert warned[Unlearnt.SWING] > 0.8
        assert good == 1.0


def test_a_pause_is_not_slow_and_a_gap_begins_anew(model):
    t = np.arange(0.0, 60.0, 1 / 30)
    moving = np.minimum(t, 20.0) + np.maximum(t - 40.0, 0.0)  # stands for 20 s
    samples = stream(moving)
    samples[:, [1, 3]] += np.random.default_rng(4).uniform(-0.01, 0.01, (len(t), 2))
    warned, _ = shares(ready(model), t, samples)
    assert max(warned.values()) == 0.0
    corrector = ready(model)
    shares(corrector, t[:600], stream(3.0 * t[:600]))
    assert corrector.unlearnt == Unlearnt.FASTER
    corrector.step(100.0, stream(t[:1])[0])
    assert corrector.unlearnt == Unlearnt.LEARNT


def test_a_training_without_a_range_or_a_rate_warns_of_none(model):
    domain = model.training_domain
    edited = replace(domain, swing_upper=domain.swing_lower, pace_lower=0.0, pace_upper=0.0)
    t = np.arange(0.0, 30.0, 1 / 30)
    warned, good = shares(ready(replace(model, training_domain=edited)), t, stream(2.0 * t))
    assert good == 1.0
    assert warned[Unlearnt.FASTER] == warned[Unlearnt.SLOWER] == 0.0


def test_a_trace_holds_the_warnings(model):
    t = np.arange(0.0, 30.0, 1 / 30)
    samples = stream(2.0 * t)
    columns = {"t": t} | dict(zip(ready(model).signals, samples.T, strict=True))
    moving = Recording.from_columns(
        columns, Provenance("raven2", arm="left"), {"effort/shoulder": "Nm", "effort/elbow": "Nm"}
    )
    trace, corrector = ready(model).run(moving), ready(model)
    expected = []
    for stamp, sample in zip(t.tolist(), samples, strict=True):
        corrector.step(stamp, sample)
        expected.append(int(corrector.unlearnt))
    assert trace.unlearnt.tolist() == expected
    assert max(expected) == Unlearnt.FASTER
