"""`truejoint plate`, `bolt` and `rezero`: the whole way of a block, and what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from tests.tip.test_touch_calibration import session as from_nothing
from tests.tip.test_touch_calibration import without_truth
from tests.tip.touched_arm import ROBOT, Touched, fitted, touched

import truejoint
from truejoint.cli.touch import follow_plan, prompted
from truejoint.errors import CalibrationError
from truejoint.recordings import write_parquet
from truejoint.tip import read_block
from truejoint.tip.block import block_text
from truejoint.tip.plan import design_pose, of_model


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
    assert {p.name for p in (tmp_path / "block").iterdir()} == {"block.stl", "block.toml"}
    assert "exists already" in call("touch", "block", "raven2", "-o", tmp_path / "block").err
    assert call("touch", "block", "davinci_grasper", "-o", tmp_path / "other").code == 2


def test_a_plan_names_each_dimple_once(call, folder):
    result = call("touch", "run", folder / "model.safetensors", "--block", folder / "block.toml",
                  "--count", "8")  # fmt: skip
    assert result.code == 0, result.err
    numbers = [line.split("│")[2].strip() for line in result.out.splitlines() if "rising" in line
               or "falling" in line]  # fmt: skip
    assert len(set(numbers)) == 8


def test_a_simulated_arm_touches_what_re_zeroes_its_model(call, session, tmp_path):
    block = tmp_path / "block"
    assert call("touch", "block", "raven2", "-o", block).code == 0
    model = session / "m.st"
    common = [model, "--block", block / "block.toml"]
    made = call("touch", "run", *common, "--count", "6", "-o", tmp_path / "first.csv")
    assert made.code == 0, made.err
    bolted = call(
        "touch", "bolt", *common, "--touches", tmp_path / "first.csv", "-o", tmp_path / "p.toml"
    )
    assert bolted.code == 0, bolted.err
    again = call(
        "touch", "run", model, "--bolted", tmp_path / "p.toml", "--seed", "3", "--count", "4",
        "-o", tmp_path / "today.csv",
    )  # fmt: skip
    assert again.code == 0, again.err
    assert len((tmp_path / "today.csv").read_text().splitlines()) == 5
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


def test_a_run_goes_on_after_a_touch_that_is_refused(folder, tmp_path, capsys):
    plate = read_block(folder / "block.toml")
    stops = of_model(fitted(), design_pose(plate, ROBOT), finds_block=True).plan(4)
    made, seated = [], []

    def seat(stop) -> float:
        seated.append(stop.dimple)
        asked = list(dict.fromkeys(seated))
        made.append(touched(block=plate, dimples=[*asked, next(n for n in plate.points
                                                               if n not in asked)]))  # fmt: skip
        return made[-1].touches.t[len(asked) - 1] + (0.1 if len(seated) == 2 else 0.0)

    recorder = SimpleNamespace(recording=lambda: made[-1].recording)
    output = tmp_path / "touches.csv"
    touches = follow_plan(stops, recorder, seat, output, goes_on=True)
    assert seated == [stops[0].dimple, *[stops[1].dimple] * 2, *(s.dimple for s in stops[2:])]
    assert touches.dimple == tuple(stop.dimple for stop in stops)
    assert len(output.read_text().splitlines()) == 5
    assert "rest for 0.3 s" in capsys.readouterr().err
    seated.clear()
    with pytest.raises(CalibrationError, match=r"moves by .* while dimple"):
        follow_plan(stops, recorder, seat, output)


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
    for wrong, said in (
        (how[:2], "--touches needs --block"),
        (how[2:], "--block needs --touches"),
        ([], "give --touches with --block, or --points"),
        ([*how, "--points", rests / "shots.csv"], "--touches and --points: give one of the two"),
        ([*how, "--report", tmp_path / "touches.pdf"], "a report is an HTML page"),
        ([*how, "--prior", tmp_path / "none.st"], "none.st"),
        (["--touches", rests / "shots.csv", *how[2:]], "want t,dimple"),
    ):
        refused = call(*arguments, *wrong, "--force")
        assert refused.code == 2, wrong
        assert said in refused.err
        assert refused.err.count("\n") == 1


def test_an_older_model_is_a_prior_of_touches(call, rests, tmp_path):
    older = tmp_path / "older.safetensors"
    truejoint.write_calibration(fitted(), older)
    made = call("touch", "calibrate", rests / "t.parquet", "--touches", rests / "t.csv", "--block",
                rests / "block.toml", "-o", tmp_path / "m.safetensors", "--prior", older,
                "--json")  # fmt: skip
    assert made.code == 0, made.err
    assert json.loads(made.out)["metadata"]["touch"]["prior"] == ["raven2 (left arm)"]


def test_shots_of_a_tracker_make_a_model(call, rests, tmp_path):
    made = call("touch", "calibrate", rests / "t.parquet", "--points", rests / "shots.csv", "-o",
                tmp_path / "m.safetensors", "--touch-sd-mm", "0.2")  # fmt: skip
    assert made.code == 0, made.err
    assert "30 touches" in made.out


def test_touches_of_an_arm_without_a_model_are_planned(call, folder):
    plate = ["--block", folder / "block.toml"]
    result = call("touch", "run", "raven2", *plate, "--count", "12")
    assert result.code == 0, result.err
    lines = [line for line in result.out.splitlines() if "rising" in line or "falling" in line]
    assert len({line.split("│")[2] for line in lines}) == 12
    for wrong, said in (
        (["raven2", *plate, "--count", "8"], "--count 8: it takes 12 at least; give so many"),
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
