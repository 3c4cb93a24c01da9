"""`truejoint plate`, `bolt` and `rezero`: the whole way of a block, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import typer
from tests.tip.test_touch_calibration import session as from_nothing
from tests.tip.test_touch_calibration import without_truth
from tests.tip.touched_arm import ROBOT, Touched, fitted, touched

import truejoint
from truejoint.cli.touch import follow_guide, prompted
from truejoint.errors import CalibrationError
from truejoint.recordings import write_parquet
from truejoint.tip import Touches, read_block
from truejoint.tip.block import block_text
from truejoint.tip.guide import Guide, design_pose, of_model


def kept(made: Touched, path: Path) -> None:
    """Write touches, and the recording beside them."""
    rows = zip(made.touches.t, made.touches.dimple, strict=True)
    path.write_text("t,dimple\n" + "".join(f"{t!r},{n}\n" for t, n in rows))
    write_parquet(made.recording, path.with_suffix(".parquet"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("block")
    first = touched(24)
    truejoint.write_calibration(fitted(), folder / "model.safetensors")
    (folder / "block.toml").write_text(block_text(first.block))
    kept(first, folder / "first.csv")
    kept(touched(6, 4, offset=(0.0, 0.006, 0.0), block=first.block, homing_id="2"),
         folder / "today.csv")  # fmt: skip
    return folder


def test_a_block_is_bolted_and_a_model_re_zeroed_by_it(call, folder, tmp_path):
    pose, model = tmp_path / "pose.toml", tmp_path / "today.safetensors"
    bolted = call("touch", "bolt", folder / "model.safetensors", "--touches", folder / "first.csv",
                  "--block", folder / "block.toml", "-o", pose)  # fmt: skip
    assert bolted.code == 0, bolted.err
    assert "test block in the base of raven2 left, within" in bolted.out
    arguments = [folder / "model.safetensors", "--touches", folder / "today.csv", "--bolted", pose]
    done = call("rezero", *arguments, "-o", model)
    assert done.code == 0, done.err
    assert "re-zeroed by 6 touches" in done.out
    assert re.search(r"hold a move of the block by [\d.]+ mm since its pose was found", done.out)
    again = truejoint.read_calibration(model)
    assert again.offset[1] == pytest.approx(0.006, abs=0.003)
    assert again.zero.homing_id == "2"
    told = call("rezero", *arguments, "-o", model, "--force", "--json")
    facts = json.loads(told.out)
    assert facts["offset"] == again.zero.shift.tolist()
    assert facts["left_out"] == []


def test_what_does_not_go_together_is_one_line(call, folder, tmp_path):
    common = [folder / "model.safetensors", "--touches", folder / "today.csv"]
    block = ["--block", folder / "block.toml"]
    for command, said in (
        (["rezero", *common, "--bolted", folder / "block.toml"], "no key called 'name'"),
        (["rezero", *common, "--bolted", folder / "none.toml"], "none.toml"),
        (["touch", "bolt", *common, "--block", folder / "first.csv"], "is not TOML"),
        (["touch", "bolt", *common[:2], folder / "model.safetensors", *block], "t,dimple"),
        (["touch", "bolt", *common, *block, folder / "no.parquet"], "no such file"),
    ):  # fmt: skip
        result = call(*command, "-o", tmp_path / "out.safetensors")
        assert result.code == 2
        assert said in result.err
        assert result.err.count("\n") == 1
        assert "fault of truejoint" not in result.err


def test_a_block_is_designed(call, tmp_path):
    result = call("touch", "block", "raven2", "-o", tmp_path / "block")
    assert result.code == 0, result.err
    told = " ".join(result.out.split())
    assert "dimples in reach" in told
    stands = re.findall(r"dimple (\d+) is about \((.+?)\) mm", told)
    made = read_block(tmp_path / "block" / "block.toml")
    assert [number for number, _ in stands] == ["1", str(len(made.points))]
    for number, place in stands:
        expected = 1e3 * (made.rotation @ made.points[number] + made.translation)
        assert [float(x) for x in place.split(",")] == pytest.approx(expected, abs=0.6)
    assert {p.name for p in (tmp_path / "block").iterdir()} == {
        "block.stl", "block.svg", "block.toml",
    }  # fmt: skip
    assert "exists already" in call("touch", "block", "raven2", "-o", tmp_path / "block").err
    assert call("touch", "block", "davinci_grasper", "-o", tmp_path / "other").code == 2


def test_a_plan_names_each_dimple_once(call, folder):
    result = call("touch", "run", folder / "model.safetensors", "--block", folder / "block.toml",
                  "--touches", "8")  # fmt: skip
    assert result.code == 0, result.err
    numbers = [line.split("│")[2].strip() for line in result.out.splitlines() if "rising" in line
               or "falling" in line]  # fmt: skip
    assert len(set(numbers)) == 8


def test_a_simulated_arm_touches_what_re_zeroes_its_model(call, session, tmp_path):
    block = tmp_path / "block"
    assert call("touch", "block", "raven2", "-o", block).code == 0
    model = session / "m.st"
    common = [model, "--block", block / "block.toml"]
    made = call("touch", "run", *common, "--touches", "6", "-o", tmp_path / "first.csv")
    assert made.code == 0, made.err
    assert made.err.count("tip within") == 3
    bolted = call(
        "touch", "bolt", *common, "--touches", tmp_path / "first.csv", "-o", tmp_path / "p.toml"
    )
    assert bolted.code == 0, bolted.err
    again = call(
        "touch", "run", model, "--bolted", tmp_path / "p.toml", "--seed", "3", "--until-mm", "9",
        "-o", tmp_path / "today.csv",
    )  # fmt: skip
    assert again.code == 0, again.err
    assert len((tmp_path / "today.csv").read_text().splitlines()) == 5  # near enough after four
    done = call("rezero", model, "--touches", tmp_path / "today.csv", "--bolted",
                tmp_path / "p.toml", "-o", tmp_path / "m.safetensors")  # fmt: skip
    assert done.code == 0, done.err
    refused = call("touch", "run", model, "-o", tmp_path / "none.csv")
    assert refused.code == 2
    assert "--block, to find where it stands, or --bolted" in refused.err
    refused = call("touch", "run", *common, "-o", tmp_path / "touches.parquet")
    assert refused.code == 2
    assert "touches are written as .csv" in refused.err


def test_a_person_is_asked_once_a_touch(monkeypatch):
    asked, stop = [], SimpleNamespace(dimple="17", words="shoulder rising")
    monkeypatch.setattr(typer, "prompt", lambda text, **_: asked.append(text))
    device = SimpleNamespace(measured_js=lambda: SimpleNamespace(t=4.25))
    monkeypatch.setattr("truejoint.cli.touch._AFTER", 0.0)
    assert prompted(device, stop) == 4.25
    assert asked == ["dimple 17, come with shoulder rising; seated?"]


@pytest.mark.parametrize("is_early", [True, False])
def test_a_run_goes_on_after_a_touch_that_is_refused(
    folder, tmp_path, capsys, monkeypatch, is_early
):
    plate = read_block(folder / "block.toml")
    pose = design_pose(plate, ROBOT)
    guide = Guide(of_model(fitted(), pose, finds_block=True), 4)
    made, seated, early = [], [], 0.1 if is_early else 0.0
    if not is_early:
        fail = Mock(side_effect=CalibrationError("do not fit"))
        monkeypatch.setattr("truejoint.tip.touch.fit_block", fail)

    def seat(stop) -> float:
        seated.append(stop.dimple)
        asked = list(dict.fromkeys(seated))
        made.append(touched(block=plate, dimples=[*asked, next(n for n in plate.points
                                                               if n not in asked)]))  # fmt: skip
        return made[-1].touches.t[len(asked) - 1] + (early if len(seated) == 2 else 0.0)

    recorder = SimpleNamespace(recording=lambda: made[-1].recording)
    output = tmp_path / "touches.csv"
    touches = follow_guide(guide, recorder, seat, output, 0.0, goes_on=is_early)
    assert len(seated) == 4 + is_early
    assert len(set(seated)) == len(touches) == 4
    assert len(output.read_text().splitlines()) == 5
    assert ("rest for 0.3 s" if is_early else "do not fit") in capsys.readouterr().err


def test_a_run_is_not_ended_before_there_are_enough(tmp_path):
    made: list[str] = []

    def take(stop, t, recording) -> SimpleNamespace:
        made.append(stop.dimple)
        return SimpleNamespace(count=len(made), off=None, tip_sd=1e-4)

    guide = SimpleNamespace(
        next_stop=lambda: SimpleNamespace(dimple=str(len(made))),
        take=take,
        touches=lambda: Touches(tuple(map(float, range(len(made)))), tuple(made)),
    )
    recorder = SimpleNamespace(recording=lambda: None)
    seat = Mock(return_value=0.0)
    follow_guide(guide, recorder, seat, tmp_path / "touches.csv", 1e-3, fewest=6)
    assert len(made) == 6


@pytest.fixture(scope="module")
def rests(tmp_path_factory) -> Path:
    """Touches of an arm of which nothing is known, as t.csv, and as shots of a tracker."""
    folder = tmp_path_factory.mktemp("rests")
    recording, touches, plate, _ = from_nothing()
    kept(Touched(without_truth(recording), touches, plate, np.zeros(3)), folder / "t.csv")
    (folder / "block.toml").write_text(block_text(plate))
    rows = zip(touches.t, 1e3 * plate.at(touches.dimple), strict=True)
    lines = [f"{t!r},{x!r},{y!r},{z!r}" for t, (x, y, z) in ((t, p.tolist()) for t, p in rows)]
    (folder / "shots.csv").write_text("\n".join(["t,x_mm,y_mm,z_mm", *lines]))
    return folder


def test_a_model_is_made_of_touches_alone(call, rests, tmp_path):
    arguments = ["touch", "calibrate", rests / "t.parquet", "-o", tmp_path / "m.safetensors"]
    how = ["--touches", rests / "t.csv", "--block", rests / "block.toml"]
    made = call(*arguments, *how, "--report", tmp_path / "touches.html")
    assert made.code == 0, made.err
    assert re.search(r"points left out in turn are [\d.]+ mm off", made.out)
    assert re.search(r"at most [\d.]+ mm off near the touches, of which the noise", made.out)
    assert "zero of shoulder: not seen" in made.out
    assert "not seen" in call("show", tmp_path / "m.safetensors").out
    page = (tmp_path / "touches.html").read_text()
    assert "zero of shoulder: not seen" in page
    assert "--report" in page  # the command that makes it
    again = [*arguments[:4], tmp_path / "again.safetensors", *how]
    refused = call(*again, "--report", tmp_path / "touches.html")
    assert refused.code == 2
    assert "exists already" in refused.err
    assert not (tmp_path / "again.safetensors").exists()
    (tmp_path / "empty").mkdir()
    for wrong, said in (
        (how[:2], "--touches needs --block"),
        (how[2:], "--block needs --touches"),
        ([], "give --touches with --block, or --points"),
        ([*how, "--points", rests / "shots.csv"], "--touches and --points: give one of the two"),
        ([*how, "--report", tmp_path / "touches.pdf"], "a report is an HTML page"),
        ([*how, "--prior", tmp_path / "empty"], "no model file is in this folder"),
        (["--touches", rests / "shots.csv", *how[2:]], "want t,dimple"),
    ):
        refused = call(*arguments, *wrong, "--force")
        assert refused.code == 2, wrong
        assert said in refused.err
        assert refused.err.count("\n") == 1


def test_three_other_arms_and_an_older_model_are_priors_of_touches(call, rests, tmp_path):
    arms = tmp_path / "arms"
    arms.mkdir()
    for number in range(3):
        truejoint.write_calibration(fitted(), arms / f"arm{number}.safetensors")
    common = ["touch", "calibrate", rests / "t.parquet", "--touches", rests / "t.csv", "--block",
              rests / "block.toml", "-o", tmp_path / "m.safetensors", "--force"]  # fmt: skip
    for prior, count in ((arms, 3), (arms / "arm0.safetensors", 1)):
        made = call(*common, "--prior", prior, "--json")
        assert made.code == 0, made.err
        assert len(json.loads(made.out)["metadata"]["touch"]["prior"]) == count
    (arms / "arm2.safetensors").unlink()
    refused = call(*common, "--prior", arms)
    assert refused.code == 2
    assert "2 calibrations are too few" in refused.err


def test_shots_of_a_tracker_make_a_model(call, rests, tmp_path):
    made = call("touch", "calibrate", rests / "t.parquet", "--points", rests / "shots.csv", "-o",
                tmp_path / "m.safetensors", "--touch-sd-mm", "0.2")  # fmt: skip
    assert made.code == 0, made.err
    assert "30 touches" in made.out


def test_touches_of_an_arm_without_a_model_are_planned(call, folder):
    plate = ["--block", folder / "block.toml"]
    result = call("touch", "run", "raven2", *plate, "--touches", "12")
    assert result.code == 0, result.err
    lines = [line for line in result.out.splitlines() if "rising" in line or "falling" in line]
    assert len({line.split("│")[2] for line in lines}) == 12
    for wrong, said in (
        (["raven2", *plate, "--touches", "8"], "--touches 8: it takes 12 at least; give so many"),
        (["raven2"], "without a model, takes --block"),
        (["raven2", "--bolted", folder / "block.toml"], "without a model, takes --block"),
        (["raven3", *plate], "raven3"),
        (["forceps", *plate], "is for raven2"),
        ([folder / "none.safetensors", *plate], "none.safetensors"),
        ([folder / "model.safetensors", *plate, "--prior", folder], "is for an arm without"),
        (["raven2", *plate, "--prior", folder / "none.st"], "none.st"),
    ):
        refused = call("touch", "run", *wrong)
        assert refused.code == 2, wrong
        assert said in refused.err
        assert refused.err.count("\n") == 1
