import math
from operator import attrgetter

import numpy as np
import pytest

from truejoint.errors import TruejointError
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import friction_at_pretension
from truejoint.simulation.forceps.specimens import population, specimen
from truejoint.simulation.forceps.twin import simulate_forceps
from truejoint.simulation.parameter_file import shipped_spreads

POPULATION = population(150, seed=11)
PRIOR = shipped_spreads("forceps/lugre_prior.toml")


def yielding(parameters, mass, direction="opposing"):
    """By how much the weight turns the jaw [deg], from before the hand to the end."""
    when = {"start": 0.5, "loaded_from": 6.0, "loaded_to": 8.0, "end": 10.0}
    test = LoadTest(mass, direction, speed=math.radians(7.5), **when)
    run = simulate_forceps(parameters, test, seed=1, log_rate=50.0)
    before = run.joint[run.t < test.loaded_from, 0][-1]
    return math.degrees(run.joint[-1, 0] - before)


@pytest.mark.parametrize(
    ("name", "jaw", "slider"), [("nominal", 1.56, 0.20), ("A", 6.64, 0.26), ("B", 7.35, 0.414)]
)
def test_their_friction_is_the_documented_one(name, jaw, slider):
    torque, force = friction_at_pretension(specimen(name))
    assert 1e3 * torque == pytest.approx(jaw, abs=0.005)
    assert force == pytest.approx(slider, abs=0.001)


def test_an_unknown_specimen_is_refused_with_the_known_ones():
    with pytest.raises(TruejointError, match="nominal, A, B"):
        specimen("C")
    assert len({repr(specimen(name)) for name in ("nominal", "A", "B")}) == 3


@pytest.mark.parametrize(
    ("name", "mass", "least", "most"),
    [  # fifty grams hardly turn the jaw of a specimen like the paper's
        ("A", 0.05, -0.5, 0.5), ("B", 0.05, -0.5, 0.5),
        ("nominal", 0.25, -7.0, -2.4), ("A", 0.25, -7.0, -2.4), ("B", 0.25, -7.0, -0.5),
    ],
)  # fmt: skip
def test_a_weight_turns_the_jaw_by_so_much(name, mass, least, most):
    assert least < yielding(specimen(name), mass) < most


def test_a_weight_along_the_motion_turns_it_further_than_one_against():
    along, against = (yielding(specimen("A"), 0.1, way) for way in ("along", "opposing"))
    assert along > max(1.0, 4 * abs(against))


def test_the_same_seed_draws_the_same_population_and_more_of_it():
    assert population(150, seed=11) == POPULATION
    assert population(5, seed=11) == POPULATION[:5]
    assert population(5, seed=12) != POPULATION[:5]
    assert len(set(map(repr, POPULATION))) == 150


@pytest.mark.parametrize("name", ["capstan", "between", "mixed"])
def test_other_priors_draw_other_frictions_of_the_same_instruments(name):
    drawn = population(40, seed=11, prior=name)
    assert population(3, seed=11, prior=name) == drawn[:3]
    laws = {p.contact.law for p in drawn}
    assert laws == ({"maxwell_slip"} if name == "capstan" else {"lugre", "maxwell_slip"})
    assert [p.assembly.pretension for p in drawn] == [
        p.assembly.pretension for p in POPULATION[:40]
    ]
    plain = [p == own for p, own in zip(drawn, POPULATION, strict=False)]
    assert (0.1 < np.mean(plain) < 0.6) if name == "mixed" else not any(plain)
    guides = np.array([p.reset_cable.guide_friction for p in drawn])[~np.array(plain)]
    assert 0.0 < guides.min() < guides.max() <= 0.06
    assert max(abs(p.mechanism.wheel_radius / 9.75e-3 - 1.0) for p in drawn) < 0.201


def test_a_population_has_a_prior_and_a_size():
    with pytest.raises(TruejointError, match="lugre, capstan, between, mixed"):
        population(1, prior="dahl")
    for count in (0, -1, 100_001):
        with pytest.raises(TruejointError, match=str(count)):
            population(count)


@pytest.mark.parametrize(
    ("value", "low", "high"),
    [
        *((attrgetter(name), *spread[:2]) for name, spread in PRIOR.items() if "." in name),
        *((attrgetter(f"{cable}_cable.stiffness"), 9e3, 17.1e3) for cable in ("drive", "reset")),
        (attrgetter("drive_cable.damping"), 0.3, 3.0),
        (attrgetter("reset_cable.stiffening"), 0.1, 0.5),
        (attrgetter("drive_cable.elastic_share"), 0.75, 0.97),
        (attrgetter("drive_cable.hysteresis_distance"), 20e-6, 150e-6),
        (lambda p: friction_at_pretension(p)[0], 0.3e-3, 8e-3),
        (lambda p: friction_at_pretension(p)[1], 0.05, 0.5),
        (attrgetter("jaw_friction.stribeck_ratio"), 1.0, 1.05),
        (attrgetter("jaw.eccentricity_phase"), -math.pi, math.pi),
    ],
)
def test_the_population_fills_its_documented_range_and_stays_inside(value, low, high):
    values = np.array([value(p) for p in POPULATION])
    assert low <= values.min() < values.max() <= high
    assert np.ptp(values) > 0.75 * (high - low)


def test_what_the_cables_share_is_one_draw():
    for p in POPULATION[:20]:
        assert p.drive_cable.stiffening == p.reset_cable.stiffening
        assert p.drive_cable.stiffness == pytest.approx(p.reset_cable.stiffness, rel=0.11)
        assert p.drive_cable.stiffness != p.reset_cable.stiffness


def test_logarithmic_draws_have_their_median_at_the_geometric_mean():
    spread = PRIOR["jaw_friction"]
    rng = np.random.default_rng(0)
    drawn = [spread.draw(rng) for _ in range(2000)]
    assert np.median(drawn) == pytest.approx(math.sqrt(0.3e-3 * 8e-3), rel=0.1)
