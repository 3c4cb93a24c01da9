"""`truejoint touch` and `rezero`: the whole way of a block, and what is refused."""

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


def write_touches(made: Touched, path: Path) -> None:
    """Write touches, and the recording beside them."""
    rows = zip(made.touches.t, made.touches.dimple, strict=True)
    path.write_text("t,dimple\n" + "".join(f"{t!r},{n}\n" for t, n in rows))
    write_parquet(made.recording, path.with_suffix(".parquet"))


def refuse_all(call, begin: str, *ends: tuple[str, str]) -> None:
    """Call lines that begin alike and are wrong, each of which is one line's answer."""
    for end, said in ends:
        assert call.refuses(said, f"{begin} {end}").count("\n") == 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("block")
    first = touched(24)
    truejoint.write_calibration(fitted(), folder / "model.safetensors")
    (folder / "block.toml").write_text(block_text(first.block))
    write_touches(first, folder / "first.csv")
    today = touched(6, 4, offset=(0.0, 0.006, 0.0), block=first.block, homing_id="2")
    write_touches(today, folder / "today.csv")
    return folder


def test_a_block_is_bolted_and_a_model_re_zeroed_by_it(call, folder):
    how = f"--touches {folder}/first.csv --block {folder}/block.toml -o pose.toml"
    bolted = call.good(f"touch bolt {folder}/model.safetensors {how}")
    assert "test block in the base of raven2 left, within" in bolted.out
    rezero = f"rezero {folder}/model.safetensors --touches {folder}/today.csv --bolted pose.toml"
    done = call.good(f"{rezero} -o m.safetensors")
    assert "re-zeroed by 6 touches" in done.out
    assert re.search(r"hold a move of the block by [\d.]+ mm since its pose was found", done.out)
    again = truejoint.read_calibration("m.safetensors")
    assert again.offset[1] == pytest.approx(0.006, abs=0.003)
    assert again.zero.homing_id == "2"
    facts = call.json(f"{rezero} -o m.safetensors --force")
    assert facts["offset"] == again.zero.shift.tolist()
    assert facts["left_out"] == []


def test_what_does_not_go_together_is_one_line(call, folder):
    touches = f"{folder}/model.safetensors --touches {folder}/today.csv -o out.st"
    refuse_all(
        call, f"rezero {touches} --bolted",
        (f"{folder}/block.toml", "no key called 'name'"), ("none.toml", "none.toml"),
    )  # fmt: skip
    refuse_all(
        call, f"touch bolt {touches} --block",
        (f"{folder}/first.csv", "is not TOML"), (f"{folder}/block.toml no.parquet", "no such file"),
        (f"{folder}/block.toml --touches {folder}/model.safetensors", "t,dimple"),
    )  # fmt: skip


def test_a_block_is_designed(call):
    told = " ".join(call.good("touch block raven2 -o block").out.split())
    assert "dimples in reach" in told
    stands = re.findall(r"dimple (\d+) is about \((.+?)\) mm", told)
    made = read_block(Path("block/block.toml"))
    assert [number for number, _ in stands] == ["1", str(len(made.points))]
    for number, place in stands:
        expected = 1e3 * (made.rotation @ made.points[number] + made.translation)
        assert [float(x) for x in place.split(",")] == pytest.approx(expected, abs=0.6)
    assert {p.name for p in Path("block").iterdir()} == {"block.stl", "block.toml"}
    call.refuses("exists already", "touch block raven2 -o block")
    assert call("touch block davinci_grasper -o other").code == 2


def planned(said: str) -> set[str]:
    """Numbers of the dimples in a plan that was printed."""
    lines = [line for line in said.splitlines() if "rising" in line or "falling" in line]
    return {line.split("│")[2].strip() for line in lines} - {""}  # of a line that is folded


def test_a_simulated_arm_touches_what_re_zeroes_its_model(call, session, folder):
    plan = f"touch run {folder}/model.safetensors --block {folder}/block.toml --count 8"
    assert len(planned(call.good(plan).out)) == 8
    call.good("touch block raven2 -o block")
    block = f"{session}/m.st --block block/block.toml"
    call.good(f"touch run {block} --count 6 -o first.csv")
    call.good(f"touch bolt {block} --touches first.csv -o p.toml")
    call.good(f"touch run {session}/m.st --bolted p.toml --seed 3 --count 4 -o today.csv")
    assert len(Path("today.csv").read_text().splitlines()) == 5
    call.good(f"rezero {session}/m.st --touches today.csv --bolted p.toml -o m.safetensors")
    said = "--block, to find where it stands, or --bolted"
    call.refuses(said, f"touch run {session}/m.st -o none.csv")
    call.refuses("touches are written as .csv", f"touch run {block} -o touches.parquet")


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
    write_touches(Touched(without_truth(recording), touches, plate, np.zeros(3)), folder / "t.csv")
    (folder / "block.toml").write_text(block_text(plate))
    rows = zip(touches.t, 1e3 * plate.at(touches.dimple), strict=True)
    lines = [f"{t!r},{x!r},{y!r},{z!r}" for t, (x, y, z) in ((t, p.tolist()) for t, p in rows)]
    (folder / "shots.csv").write_text("\n".join(["t,x_mm,y_mm,z_mm", *lines]))
    return folder


def test_a_model_is_made_of_touches_alone(call, rests):
    line = f"touch calibrate {rests}/t.parquet"
    touches, block = f"--touches {rests}/t.csv", f"--block {rests}/block.toml"
    made = call.good(f"{line} -o m.st {touches} {block} --report touches.html")
    assert re.search(r"points left out in turn are [\d.]+ mm off", made.out)
    assert re.search(r"at most [\d.]+ mm off near the touches, of which the noise", made.out)
    assert "zero of shoulder: not seen" in made.out
    assert "not seen" in call("show m.st").out
    page = Path("touches.html").read_text()
    assert "zero of shoulder: not seen" in page
    assert "--report" in page  # the command that makes it
    again = f"{line} -o again.st {touches} {block} --report touches.html"
    call.refuses("exists already", again)
    assert not Path("again.st").exists()
    refuse_all(
        call, f"{line} -o m.st --force",
        (touches, "--touches needs --block"), (block, "--block needs --touches"),
        ("", "give --touches with --block, or --points"),
        (f"{touches} {block} --points x.csv", "--touches and --points: give one of the two"),
        (f"{touches} {block} --report touches.pdf", "a report is an HTML page"),
        (f"{touches} {block} --prior none.st", "none.st"),
        (f"--touches {rests}/shots.csv {block}", "want t,dimple"),
    )  # fmt: skip


def test_an_older_model_is_a_prior_of_touches_and_shots_make_a_model(call, rests):
    truejoint.write_calibration(fitted(), "older.safetensors")
    touches = f"--touches {rests}/t.csv --block {rests}/block.toml --prior older.safetensors"
    made = call.json(f"touch calibrate {rests}/t.parquet {touches} -o m.safetensors")
    assert made["metadata"]["touch"]["prior"] == ["raven2 (left arm)"]
    shots = f"--points {rests}/shots.csv --touch-sd-mm 0.2"
    said = call.good(f"touch calibrate {rests}/t.parquet {shots} -o shots.safetensors").out
    assert "30 touches" in said


def test_touches_of_an_arm_without_a_model_are_planned(call, folder):
    block = f"--block {folder}/block.toml"
    assert len(planned(call.good(f"touch run raven2 {block} --count 12").out)) == 12
    call.good("touch block dvrk_psm:psm1 -o psm")
    plan = call.good("touch run dvrk_psm:psm1 --block psm/block.toml --count 12").out
    assert len(planned(plan)) == 12
    refuse_all(
        call, "touch run",
        (f"raven2 {block} --count 8", "--count 8: it takes 12 at least; give so many"),
        ("raven2", "without a model, takes --block"),
        (f"raven2 --bolted {folder}/block.toml", "without a model, takes --block"),
        (f"raven3 {block}", "raven3"), (f"forceps {block}", "is for raven2"),
        (f"none.safetensors {block}", "none.safetensors"),
        (f"{folder}/model.safetensors {block} --prior .", "is for an arm without"),
        (f"raven2 {block} --prior none.st", "none.st"),
    )  # fmt: skip
