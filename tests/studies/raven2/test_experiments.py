"""The studies of RAVEN-II, made small: what they compute, print and refuse."""

from itertools import chain, product

import numpy as np
import pytest
from pandas import DataFrame

from truejoint.errors import StudyError
from truejoint.estimators import NeuralNetwork, registry
from truejoint.estimators.family import TARGETS
from truejoint.studies import get_study, run_study
from truejoint.studies.claim_tests import judged
from truejoint.studies.raven2 import lasting, rivals, tables, training
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.rows import select

RAVEN = s.specimens(("peng2024",))["peng2024"]
FEW = {"specimens": "peng2024", "networks": 1}
ONE = FEW | {"sessions": 1}


@pytest.fixture(scope="module")
def session():
    """Two short trainings on one arm, and a test."""
    arm, _ = s.homed(RAVEN, 5)
    return s.training_sets(arm, ("1", "1+2")), s.random_test(arm, 20.0, 1)


@pytest.fixture(scope="module", autouse=True)
def quick():
    """Hours of 20 s, and networks that have just begun to learn."""
    hasty = registry.PRESETS["dnn"]._replace(params={"epochs": 2})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(s, "HOUR", 20.0)
        patch.setattr(s, "_IDLE_TEST", 12.0)
        patch.setitem(registry.PRESETS, "dnn", hasty)
        yield


def test_sparsities_are_recorded_once_for_all_combinations(session):
    sets, _ = session
    assert sets["1"][0] is sets["1+2"][0]
    assert s.seconds_of(sets["1+2"]) == pytest.approx(sum(one.duration for one in sets["1+2"]))


def test_errors_are_those_of_the_models_on_rows_with_truth(session):
    sets, test = session
    models = s.fitted(sets["1"], 0, 0)
    found = DataFrame(s.judged(models, test))
    truth = test.columns("truth", s.JOINTS)
    known = np.isfinite(truth).all(axis=1)
    assert 0 < known.sum() < len(test)  # the encoders start and end at times of their own
    for method, estimate in (
        ("raw", test.columns("measured", s.JOINTS)),
        ("linear", models["linear"][0].correct(test)),
    ):
        expected = np.sqrt(((estimate - truth)[known] ** 2).mean(axis=0))
        assert select(found, method=method).rmse.tolist() == pytest.approx(expected, rel=1e-12)
    shown = tables.readable(found).rmse / found.rmse
    assert shown[:3].tolist() == pytest.approx([57.29578, 57.29578, 1e3])
    error = truth - test.columns("measured", s.JOINTS)
    seen = np.concatenate([one.with_truth(s.JOINTS).error(s.JOINTS) for one in sets["1"]])
    left = np.sqrt(((error[known] - seen.mean(axis=0)) ** 2).mean(axis=0))
    assert select(found, method="offset").rmse.tolist() == pytest.approx(left, rel=1e-3)


@pytest.fixture(scope="module")
def table_1():
    options = {"directions": "J1,J2-J3", "fine": "1+2", "minutes": 0.2}
    return run_study("directions", ONE | options)


def test_table_1_stands_beside_the_papers(table_1, drawn):
    text = table_1.summary.tables[0].markdown()
    row = next(line for line in text.splitlines() if "J2-J3, shoulder" in line)
    assert "(0.104) |" in row  # the paper's network
    assert "(2.103) |" in row  # and raw positions
    percents = table_1.summary.tables[1].markdown()
    assert "(12.1) |" in next(line for line in percents.splitlines() if "J2-J3, shoulder" in line)
    here = select(table_1.rows, case="J2-J3", set="1+2", joint="shoulder").set_index("method")
    share = 100 * here.rmse["dnn"] / here.rmse["offset"]
    assert f"{share:.1f} (12.1)" in percents
    assert drawn(table_1)
    # Claims on the best direction need all seven.
    assert table_1.summary.claims == []


def test_directions_have_arms_and_tests_of_their_own(table_1):
    study = get_study("directions")
    parts = study.parts(study.settings("full"))
    assert len({part.arguments["seed"] for part in parts}) == 35  # the same on both specimens
    assert len(parts) == 70
    raw = select(table_1.rows, set="1+2", method="raw", joint="elbow").rmse
    assert raw.nunique() == 2


def synthetic(errors, session=0, **labels):
    """Rows of one session by method, the same in every joint."""
    return [
        {**labels, "session": session, "method": method, "joint": joint, "rmse": value}
        for method, value in errors.items()
        for joint in s.JOINTS
    ]


def test_the_best_direction_is_found():
    usual = {"dnn": 0.2, "poly2": 0.2, "linear": 0.2, "offset": 1.0, "raw": 4.0}
    fine = dict.fromkeys(training.DIRECTIONS, usual)
    fine["J2-J3"] = {**usual, "dnn": 0.1, "poly2": 0.15, "linear": 0.15}

    def rows():
        every = product(fine.items(), range(2))
        made = (synthetic(own, session, condition=name) for (name, own), session in every)
        return DataFrame(chain.from_iterable(made))

    found = {claim.text: claim for claim in judged(training.DIRECTIONS_CLAIMS, rows())}
    best = found["J2-J3 is the best direction over all joints and models"]
    assert best.verdict == "holds"
    assert "J2-J3 13.3 %" in best.found
    assert found["trained on J2-J3, the network errs least in every joint"].holds
    assert found["joint 3: all models are best on J3"].holds is False
    fine["J1"] = {**usual, "dnn": 0.05, "poly2": 0.05, "linear": 0.05}
    best = training.DIRECTIONS_CLAIMS["best-direction"].judged(rows())
    assert best.verdict == "does not"
    assert "number 2 of 7" in best.found


@pytest.fixture(scope="module")
def hours(tmp_path_factory):
    """Two hours of every kind of work, and of the study of targets, which has the same parts."""
    options, folder = ONE | {"sets": "1", "hours": 2}, tmp_path_factory.mktemp("hours")
    return [run_study(name, options, folder=folder) for name in ("endurance", "targets")]


def test_six_hours_are_judged_hour_by_hour(hours, drawn):
    result, targets = hours
    assert result.rows.groupby("work").hour.nunique().tolist() == [2, 2, 2]
    texts = [claim.text for claim in result.summary.claims]
    assert texts == [claim.text for claim in lasting.ENDURANCE_CLAIMS.values()]
    assert drawn(result)
    assert targets.computed == 0, "the same hours"


def test_a_load_is_hung_on_the_tool_after_the_training(hours):
    rows = select(hours[0].rows, target=TARGETS[0])
    # Half a kilogram pulls at the insertion's cable, by some 0.25 mm.
    raw = select(rows, method="raw", joint="insertion", hour=0).set_index("work").rmse
    assert abs(raw.loaded - raw.unloaded) > 1e-4
    study = get_study("endurance")
    (part,) = study.parts(study.settings("small", options=FEW))
    assert part.arguments["works"] == {"idle": 0.0, "unloaded": 0.0, "loaded": 0.5}
    again = {"hours": 2, "works": {"loaded": 0.5}}
    one = DataFrame(s.calibrate_once(RAVEN, part.arguments["seed"], ("1",), 0, **again).rows)
    loaded = rows[(rows.work == "loaded") & (rows.method != "dnn")]
    assert one.rmse.tolist() == loaded.rmse.tolist(), "each begins fresh"


def test_either_target_is_the_same_to_the_linear_model(hours):
    result = hours[1]
    unloaded = select(result.rows, work="unloaded", method="linear")
    error, position = (select(unloaded, target=one).rmse.tolist() for one in TARGETS)
    assert position == pytest.approx(error, rel=1e-6)
    claims = {claim.text: claim for claim in result.summary.claims}
    assert claims["linear and polynomial model are the same either way"].holds is None
    assert "0.328" in result.summary.tables[0].markdown()


def test_hours_that_grow_are_told():
    def verdicts(**growth):
        rows = []
        for work, (first, last) in growth.items():
            for n, factor in ((0, first), (1, last)):
                errors = {"dnn": 0.1, "poly2": 0.1, "linear": 0.1, "offset": 1.0}
                for k, session in product(range(6), range(2)):
                    labels = {"hour": n, "set": str(k), "place": k, "seconds": k}
                    own = synthetic(errors, session, work=work, **labels)
                    for row in own:
                        row["rmse"] *= factor if row["joint"] == "shoulder" else 1.0
                    rows += own
        found = lasting.by_training(DataFrame(rows))
        return {claim.text: claim.holds for claim in judged(lasting.ENDURANCE_CLAIMS, found)}

    drift = "joint 1 drifts most: its error grows by the largest factor"
    grown = verdicts(idle=(1, 1), unloaded=(1, 2), loaded=(1, 4))
    assert grown[drift]
    assert grown["idle for six hours, network, linear model and fixed offset hardly get worse"]
    assert grown["joint 1: a load makes it worse"]
    assert not verdicts(idle=(1, 1), unloaded=(1, 1), loaded=(1, 4))[drift]


def test_a_homing_seen_comes_before_the_last_zigzag(monkeypatch):
    done = []
    arm, twin = s.homed(RAVEN, 1)
    monkeypatch.setattr(s, "homed", lambda *_: (arm, twin))
    monkeypatch.setattr(type(arm), "home", lambda _: done.append("home"))
    monkeypatch.setattr(s, "zigzags", lambda _, ns: [done.append(n) or n for n in ns])
    monkeypatch.setattr(s, "random_test", lambda *_: done.append("test") or "test")
    monkeypatch.setattr(s, "fitted", lambda training, *_: done.append(tuple(training)))
    monkeypatch.setattr(s, "judged", lambda *_, **__: [])
    again = {"seed": 1, "networks": 1, "seconds": 1, "divisions": (4, 5)}
    lasting.home_again(RAVEN, seen=False, homings=2, **again)
    assert done == [4, 5, "test", "home", "test", "home", "test", (4, 5)]
    done.clear()
    lasting.home_again(RAVEN, seen=True, homings=1, **again)
    assert done == [4, "test", "home", 5, "test", (4, 5)]


def test_homings_are_judged_one_by_one(drawn):
    options = {"training": "1+2", "homings": 1, "sessions": 1, "minutes": 0.2}
    result = run_study("homing", FEW | options)
    assert (result.rows.groupby("part").homings.nunique() == 2).all()
    assert len(result.summary.claims) == len(lasting.HOMING_CLAIMS)
    assert drawn(result)


def test_more_time_is_judged_by_the_seconds_it_takes(drawn):
    result = run_study("sparsity", ONE | {"sets": "2,1", "hours": 1})
    conditions = [row[0] for row in result.summary.tables[0].rows]
    assert conditions[0].startswith("1, ")  # the shorter one, though named last
    assert conditions[3].startswith("2, ")
    assert len(result.summary.claims) == len(training.SPARSITY_CLAIMS)
    assert drawn(result)
    spread = training.SPARSITY_CLAIMS["polynomial-scatters"]

    def judged(poly2, *others):
        sessions = DataFrame({"poly2": poly2, "dnn": others[0], "linear": others[-1]})
        made = (synthetic(row, n, when="first") for n, row in sessions.iterrows())
        return spread.judged(DataFrame(chain.from_iterable(made)))

    little, much = (0.20, 0.21, 0.19, 0.20), (0.2, 0.5, 0.1, 0.9)
    assert judged(much[:1], little[:1]).holds is None
    assert judged(much, little).holds is True
    assert judged(little, little).holds is None
    assert judged(little, little, much).holds is False
    assert judged(little, little, much).look == "warn", "less scatter is no failure"


def test_the_tool_is_off_by_what_the_joints_make_of_it(session):
    _, test = session
    test = test.with_truth(s.JOINTS)
    truth = test.columns("truth", s.JOINTS)

    def tool(estimate):
        rows = DataFrame(rivals.errors_of(estimate, test)).set_index("quantity")
        return rows.rmse[["x", "y", "z", "distance"]].to_numpy()

    assert tool(truth).tolist() == [0.0] * 4
    millimetre = tool(truth + np.array([0.0, 0.0, 1e-3]))
    assert millimetre[3] == pytest.approx(1e-3, rel=1e-9)  # straight along the shaft
    assert np.linalg.norm(millimetre[:3]) == pytest.approx(1e-3, rel=1e-9)


def test_rivals_stand_beside_those_of_the_paper():
    few = {"specimens": "peng2024", "models": "linear,poly2", "sessions": 1}
    result = run_study("state-of-the-art", few | {"training": "1+2", "hours": 3})
    joints, tool = (table.markdown() for table in result.summary.tables)
    assert "Haghighipanah" in joints
    assert "| 1.195 | 1.242 | 0.927 |" in joints
    assert "Mahler" in tool


def test_what_is_compared_is_registered():
    known = {*registry.estimator_names(), registry.AUTO}
    for study, option in (("state-of-the-art", "models"), ("real", "estimators")):
        assert known.issuperset(get_study(study).settings("full")[option])


def test_fits_and_samples_are_timed():
    options = {"models": "linear,dnn", "training": "1", "samples": 1000, "repeats": 2}
    result = run_study("timing", options)
    for times in result.rows.itertuples():
        assert 0.0 < times.step <= times.step_99
        assert times.fit > 0.0
    slow = result.summary.claims[2]
    assert (slow.verdict, slow.look) == ("does not", "warn")
    assert slow.found.endswith("; better than stated")
    verdicts = {claim.text: claim.verdict for claim in result.summary.claims}
    assert verdicts["the network infers in 61 ms"] == "holds more strongly"
    assert verdicts["the linear model infers in 0.38 ms"] == "holds more strongly"


def test_features_are_all_of_the_message(drawn, monkeypatch):
    monkeypatch.setattr(
        "truejoint.studies.raven2.training.NeuralNetwork",
        lambda sizes, weight_decay: NeuralNetwork((8, 8), weight_decay=weight_decay, epochs=2),
    )
    monkeypatch.setattr("truejoint.studies.raven2.training._FIT_RATE", 30.0)
    result = run_study("features", ONE | {"sets": "1,2", "hours": 1})
    assert (result.rows.inputs == 122).all()
    wide = select(result.rows, method="wide")
    assert set(wide.set) == {"2"}
    assert set(wide.kind) == {"all"}
    assert len(result.summary.claims) == 9
    text = result.summary.tables[0].markdown()
    assert "122 of one arm" in text
    assert drawn(result)


def test_an_arm_of_ones_own_stands_beside_the_shipped_one(tmp_path):
    path = tmp_path / "loose.toml"
    path.write_text("[tool]\nwander_time = 7200.0\n", encoding="utf-8")
    found = s.specimens(("nominal", str(path)))
    assert list(found) == ["nominal", "loose"]
    assert found["loose"]["tool"]["wander_time"] == 7200.0
    assert found["nominal"]["tool"]["wander_time"] == 600.0
    with pytest.raises(StudyError, match="two have one name"):
        s.specimens((str(path), str(tmp_path / "." / "loose.toml")))
