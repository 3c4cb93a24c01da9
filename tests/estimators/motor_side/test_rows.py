"""The compiled model functions against what they stand for."""

from types import SimpleNamespace

import numpy as np
import pytest

from truejoint.estimators.motor_side import run as model
from truejoint.estimators.motor_side.learn import Motion

ELEMENTS = 3


@pytest.fixture
def joint():
    rng = np.random.default_rng(1)
    noise = dict(zip(model.NOISE, (0.04, 0.3, 0.05, 1e-4, 0.5, 0.2), strict=True))
    return SimpleNamespace(
        **noise,
        noise=np.array([noise[name] for name in model.NOISE]),
        widths=np.array([0.02, 0.1, 0.4]),
        torque=rng.normal(size=model.count_terms(ELEMENTS)),
        scales=np.array([0.0, 1.0, 1.0, 1e-3]),
    )


def test_outputs_weigh_their_terms():
    rng = np.random.default_rng(2)
    angle, states = rng.normal(size=50), rng.normal(size=(50, ELEMENTS + 2))
    coefficients = rng.normal(size=(2, model.count_terms(ELEMENTS) + 2))
    out, variance = np.empty((2, 50, 2))
    spread = np.zeros((50, ELEMENTS + 2, ELEMENTS + 2))
    model.output_rows(angle, states, spread, coefficients, out, variance)
    wanted = model.output_terms(angle, states) @ coefficients.T
    np.testing.assert_allclose(out, wanted, rtol=1e-12, atol=1e-12)


def test_measured_torque_is_response_plus_unexplained_friction(joint):
    space = model.elastic_filter(vars(joint)).model
    x, u = np.array([0.3, -0.2, 1.0, 0.7, 0.05]), np.array([0.4, 0.01])
    out = np.empty(1)
    space.measurement(x, u, space.parameters, out)
    columns = model.terms(u[:1], x[3:4], x[None, :3])
    assert out[0] == pytest.approx(0.05 + float((columns @ joint.torque)[0]), rel=1e-12)
    assert space.measurement_noise[0, 0] == pytest.approx(joint.noise_density / 1e-3)


def test_the_filter_drags_friction_along_as_the_fit_does(joint):
    rng = np.random.default_rng(3)
    angle = np.cumsum(rng.normal(scale=0.05, size=300))
    motion = Motion(angle, angle, np.r_[0.0, np.full(299, 1e-3)])
    space = model.elastic_filter(vars(joint)).model
    x = np.zeros(ELEMENTS + 2)
    followed = []
    for place, moved in zip(angle, motion.moved, strict=True):
        after = np.empty_like(x)
        space.transition(x, np.array([place, moved]), 1e-3, space.parameters, after)
        x = after
        followed.append(x[:ELEMENTS])
    np.testing.assert_allclose(followed, motion.deflections(joint.widths), atol=1e-12)


def test_unexplained_friction_keeps_its_size_however_the_way_is_cut(joint):
    space = model.elastic_filter(vars(joint)).model
    rest = ELEMENTS + 1
    for pieces in (1, 7):
        variance = joint.rest_deviation**2
        for _ in range(pieces):
            u = np.array([0.0, 0.03 / pieces])
            fade, noise = np.empty(rest + 1), np.zeros((rest + 1, rest + 1))
            x = np.eye(rest + 1)[rest]
            space.transition(x, u, 1e-3, space.parameters, fade)
            space.process_noise(x, u, 1e-3, space.parameters, noise)
            variance = fade[rest] ** 2 * variance + noise[rest, rest]
        assert variance == pytest.approx(joint.rest_deviation**2, rel=1e-12)


def test_a_load_wanders_with_time_alone(joint):
    space = model.elastic_filter(vars(joint)).model
    noise = np.zeros((ELEMENTS + 2, ELEMENTS + 2))
    space.process_noise(np.zeros(ELEMENTS + 2), np.zeros(2), 2.0, space.parameters, noise)
    wanted = np.zeros_like(noise)
    wanted[ELEMENTS, ELEMENTS] = 2.0 * joint.load_density
    np.testing.assert_allclose(noise, wanted)


def test_thinned_rows_keep_their_time_and_their_histories():
    steps = np.array([0.0, 0.1, 0.1, 0.1, 0.0, 0.1, 0.1])
    motion = Motion(np.arange(7.0), np.arange(7.0), steps)
    picked = motion.pick(np.array([0, 2, 3, 4, 6]))
    np.testing.assert_allclose(picked.dt, [0.0, 0.2, 0.1, 0.0, 0.2], atol=1e-15)
    np.testing.assert_array_equal(picked.history, [0, 0, 0, 1, 1])
    np.testing.assert_allclose(picked.travel, [0.0, 2.0, 3.0, 0.0, 2.0])
