"""A calibration of few seconds, by models of instruments of the same kind."""

from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused
from tests.synthetic import build_recording

import truejoint
from truejoint.calibration import calibrate, calibrate_like, read_calibration, write_calibration
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.polynomial.learn import Polynomial
from truejoint.estimators.stack.learn import Expert, Pooled
from truejoint.recordings import Provenance, Recording

FEATURES = ("measured/jaw", "effort/jaw")


def jaw(
    number: int, seed: int, seconds: float = 40.0, rate: float = 1.0, span: float = 0.3
) -> Recording:
    """One motion of instrument `number`: a slope, a curve, a hysteresis and a zero of its own."""
    own = np.random.default_rng(number)
    slope, curve, loop, zero = own.normal([0.1, 0.4, 0.08, 0.0], [0.02, 0.04, 0.02, 0.5])
    t = np.arange(round(50 * seconds)) / 50.0
    phase = np.random.default_rng(seed).uniform(0, 6, 2)
    q = 0.5 + span * np.sin(rate * t + phase[0]) * np.sin(0.31 * t + phase[1])
    effort = 0.02 * np.tanh(8.0 * np.gradient(q, t))
    truth = q + zero + slope * q + curve * (q - 0.4) ** 2 - loop * effort / 0.02
    truth += 2e-3 * np.random.default_rng((number, seed)).standard_normal(len(t))
    columns = {"t": t, "measured/jaw": q, "effort/jaw": effort, "truth/jaw": truth}
    about = Provenance("davinci_grasper", source=f"jaw {number} {seed}", homing_id=str(number))
    return Recording.from_columns(columns, about)


def error(model: truejoint.Calibration, recording: Recording) -> float:
    left = recording.column("truth/jaw") - model.correct(recording)[:, 0]
    return float(np.sqrt(np.mean(left**2)))


@pytest.fixture(scope="module")
def models() -> list[truejoint.Calibration]:
    targets = ("error", "position", "error", "error")
    return [
        calibrate([jaw(n, 0), jaw(n, 1, rate=2.0)], "poly2_ridge", features=FEATURES, target=target)
        for n, target in enumerate(targets)
    ]


def test_five_seconds_do_what_the_same_seconds_alone_do_not(models, tmp_path):
    errors = {"like": [], "linear": [], "poly2_ridge": []}
    for number in range(11, 16):
        brief = jaw(number, 5, seconds=5.0, span=0.05)
        unseen = jaw(number, 6, rate=2.0)
        like = calibrate_like(brief, models)
        fits = {"like": like}
        fits |= {name: calibrate(brief, name, features=FEATURES) for name in list(errors)[1:]}
        for name, fit in fits.items():
            errors[name].append(error(fit, unseen))
        assert "left_aside" not in like.metadata["like"]
    typical = {name: np.median(values) for name, values in errors.items()}
    assert typical["like"] < 0.7 * min(typical["linear"], typical["poly2_ridge"])
    path = tmp_path / "m.safetensors"
    write_calibration(like, path)
    assert read_calibration(path).correct(unseen).tobytes() == like.correct(unseen).tobytes()
    sources = {session.source for session in like.origin.sessions}
    assert {"jaw 0 0", "jaw 15 5"} <= sources  # none of which it may be judged on


def test_weights_are_those_of_the_posterior_and_sum_to_one():
    random = np.random.default_rng(3)
    X, dt = random.normal(size=(400, 2)), np.full(400, 0.05)
    dt[0] = 0.0
    slopes = np.array([[0.9, 0.1], [1.1, -0.1], [1.0, 0.3]])
    y = X @ [1.05, 0.2] + 0.7 + 0.05 * random.normal(size=400)
    lines = [Polynomial(1, ridge=False).fit(X, X @ slope) for slope in slopes]
    experts = [Expert(line.data, (0, 1), np.zeros((2, 1))) for line in lines]
    fitted = Pooled(experts, positions=(0,)).fit(X, y, dt=dt)
    weights, slope = fitted.arrays_["weights"][:3], fitted.arrays_["direct"][6, 0]
    assert weights.sum() == pytest.approx(1.0)
    predicted = X @ slopes.T
    spread = predicted - predicted.mean(axis=1, keepdims=True)
    spread -= spread.mean(axis=0)
    rest = y - predicted.mean(axis=1)
    rest -= rest.mean()
    moved = X[:, 0] - X[:, 0].mean()
    deviation = np.linalg.norm(np.linalg.lstsq(moved[:, None], spread)[0]) / np.sqrt(3.0 * 2.0)
    terms = np.column_stack([spread, moved])
    noise = np.sqrt(np.mean((rest - terms @ np.append(weights - 1 / 3, slope)) ** 2))
    scale = np.sqrt(dt.sum() / 0.5 / 400) / noise  # the prior as four rows more
    rows = np.vstack([scale * terms, np.diag([*np.sqrt([3.0] * 3), 1.0 / deviation])])
    change = np.linalg.lstsq(rows, np.append(scale * rest, np.zeros(4)))[0]
    assert weights == pytest.approx(1 / 3 + change[:3] - change[:3].mean(), rel=1e-4)
    assert slope == pytest.approx(change[3], rel=1e-3)
    assert fitted.predict(X).mean() == pytest.approx(y.mean())


def test_models_that_the_new_truth_contradicts_are_left_aside(models):
    brief = jaw(11, 5, seconds=5.0)
    turned = [
        replace(model, fitted=EstimatorData(model.fitted.family, model.fitted.params,
                {**model.fitted.arrays, "coef": -3.0 * model.fitted.arrays["coef"]}), learnt=None)
        for model in models if model.target == "error"
    ]  # fmt: skip
    made = calibrate_like(brief, turned, "linear", features=FEATURES)
    assert "times what a fixed offset leaves" in made.metadata["like"]["left_aside"]
    own = calibrate(brief, "linear", features=FEATURES)
    assert made.correct(brief).tobytes() == own.correct(brief).tobytes()


def test_an_own_fit_that_is_better_on_what_is_left_out_is_taken(models):
    several = [jaw(11, seed, rate=1.0 + 0.2 * seed) for seed in range(3)]
    made = calibrate_like(several, [calibrate(jaw(1, 0), "offset", features=FEATURES)],
                          "poly2_ridge", features=FEATURES)  # fmt: skip
    facts = made.metadata["like"]
    assert made.estimator == "poly2_ridge"
    assert "an own fit is better" in facts["left_aside"]
    assert facts["rmse"]["own"][0] < 0.5 * facts["rmse"]["like"][0]
    copied = calibrate_like([*several, several[0]], models, "poly2_ridge", features=FEATURES)
    once = calibrate_like(several, models, "poly2_ridge", features=FEATURES)
    assert copied.metadata["like"]["rmse"] == once.metadata["like"]["rmse"], "a copy was learnt"
    told = []
    kept = calibrate_like(several, models, "offset", features=FEATURES, progress=told.append)
    assert kept.estimator == "pooled"
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_what_does_not_belong_together_is_refused(models):
    brief = jaw(11, 5, seconds=5.0)
    raven = calibrate(build_recording(300), "linear")
    refused(r"like: linear of .* is of raven2", calibrate_like, brief, [*models, raven])
    refused("like: 0 models; give 1 to 9", calibrate_like, brief, [])
    refused("like: 10 models", calibrate_like, brief, [models[0]] * 10)
    said = "the models correct jaw; leave out the joints"
    refused(said, calibrate_like, brief, models, joints=["elbow"])
    table = brief.table.drop(columns="effort/jaw")
    bare = Recording(table, {n: u for n, u in brief.units.items() if n in table}, brief.provenance)
    refused("effort/jaw", calibrate_like, bare, models)
    other = calibrate(build_recording(300), "linear", joints=["elbow"])
    recording = build_recording(200, seed=4)
    refused("give models of the same joints", calibrate_like, recording, [raven, other])
