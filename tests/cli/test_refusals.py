"""A wrong call is refused in one line that says what to do, and leaves nothing behind."""

import os
import runpy
import shlex
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest
from tests.cli.conftest import Call

from truejoint.cli.calibrate import configured
from truejoint.errors import TruejointError
from truejoint.motion import Trajectory, write_trajectory

# By the beginning of a line: its end, and what is said. Nothing is read or made before.
AT_ONCE = {
    "calibrate zigzag.parquet -o new.st": [
        ("-e lin", "did you mean 'linear'?"),
        ("-e dnn --set epocs=3", "did you mean 'epochs'?"),
        ("-e dnn --set epochs=many", "not of the kind"),
        ("-e dnn --set epochs=-1", "epochs is -1"),
        ("-e dnn --set nothing=1", "no parameter of dnn called 'nothing'"),
        ("-e dnn --set epochs=3 --set epochs=4", "epochs was given before; give it once"),
        ("--set epochs=3", "--set 'epochs=3' needs one estimator; name it with -e"),
        ("-e poly2_ridge --set first=many", "'many' is no whole number"),
        ("-e rich_play --set rows=-1", "rows is -1"),
        ("--robot raven", "did you mean 'raven2'?"),
        ("--robot raven2:middle", "no arm"),
        ("--robot raven2 --joint elbw", "did you mean 'elbow'?"),
        ("--metadata format=parket", "did you mean 'parquet'?"),
        ("--metadata load=3", "no key called 'load'"),
        ("--metadata rate_hz=fast", "'fast' is no number"),
        ("--metadata session=a --metadata session=b", "session was given before; give it once"),
        ("--feature 'play(measured/elbow, x)'", "'x' is not a number"),
        ("--interval davinci_graspr_umn", "did you mean 'davinci_grasper_umn'?"),
        ("--interval kflex_tendon_sheath:nothing", "no recording fits"),
        ("--accept outlier", "did you mean 'outliers'?"),
        ("--part 0.7:0.2", "write FROM:TO with 0 <= FROM < TO <= 1"),
        ("--target both", "'both' is not one of"),
        ("--seed -1", "greater than or equal to 0"),
        ("-o m.onnx", "call it m.safetensors"),
        ("-o model.csv", "call it model.safetensors"),
        ("-o m.st", "--force"),
        ("--fit-rate-hz 0", "greater than or equal to 0.000000001"),
        ("-e", "Option '-e' requires an argument. See `truejoint calibrate --help`."),
        ("-o nosuch/m.st", "the folder nosuch does not exist"),
    ],
    "calibrate": [
        ("", "Missing argument"),
        ("zigzag.parquet", "Missing option"),
        ("nowhere.parquet -o new.st", "no such file or folder"),
        ("davinci_grasper_umn --split nothing -o new.st", "no split called 'nothing'"),
        ("m.st -o new.st --like m.st", "m.st: models alone; name a recording beside them"),
    ],
    "evaluate m.st random.parquet": [
        ("--report nosuch/report.html", "the folder nosuch does not exist"),
        ("--report report.pdf", "report.pdf: a report is an HTML page; call it report.html"),
        ("--tolerance elbo=0.2", "did you mean 'elbow'?"),
        ("--tolerance elbow", "write JOINT=VALUE"),
        ("--tolerance elbow=0", "give deg above 0"),
        ("--rezero-s long", "should be a valid number"),
    ],
    "rezero m.st -o new.st": [
        ("--ros 2 --truth /t --motor m.st", "--ros and --motor: give one of the two"),
        ("", "name the recording to re-zero from, or give --touches"),
        ("random.parquet --touches t.csv", "--touches needs --bolted"),
        ("random.parquet --touch-sd-mm 1", "--touch-sd-mm needs --touches"),
    ],
    "correct m.st random.parquet": [
        ("-o a.txt", "call it .csv or .parquet"),
        ("-o nosuch/a.csv", "the folder nosuch does not exist"),
        ("-o a.csv --level 100", "--level 100: give a probability between 0 and 100 %"),
        ("-o a.csv --level 0", "--level 0: give a probability"),
        ("random.parquet -o a.csv", "named twice"),
    ],
    "check": [
        ("m.st random.parquet --level nan --json", "--level nan: give a probability"),
        ("pipe random.parquet", "pipe: is not a file"),
    ],
    "trajectory": [
        ("zigzag --direction J9 -o z.csv", "no direction called 'J9'"),
        ("zigzag --sparsity none -o z.csv", "write it as 1/4 or 0.25"),
        ("nested --robot raven2 -o n.csv", "nested loops are for one joint"),
        ("random --sparsity 1/2 -o r.csv", "takes --duration-s, --seed; leave it out"),
        ("spiral -o s.csv", "no kind of trajectory called 'spiral'"),
        ("designed --duration-s 0 -o d.csv", "must be within [10"),
        ("random --seed -1 -o r.csv", "greater than or equal to 0"),
        ("zigzag -o y.csv --plot nosuch/p.html", "the folder nosuch does not exist"),
        ("zigzag -o pipe --force", "pipe: exists already and is no file"),
    ],
    "export": [
        ("random.parquet --to bag --compensate -o x.bag", "leave other options out"),
        ("m.st --to c --profile raven2 -o c", "is for --to bag"),
        ("m.st -o c", "Missing option"),
        ("m.st -o c --to onnx --compensate", "works only with --to c"),
        ("m.st -o c --to rust", "'rust' is not one of"),
    ],
    "collect jaw.csv -o new --robot forceps": [
        ("--robot kflex", "no digital twin of 'kflex'"),
        ("--load-grams 3000", "load is 3.0 kg"),
        ("--seed -1", "should be greater than or equal to 0"),
        ("--rezero-s 5", "--rezero-s needs --compensate"),
        ("--closed-loop --compensate m", "--closed-loop and --compensate: give one"),
        ("--lag-s 0.02", "needs --compensate or --closed-loop"),
        ("--closed-loop --lag-s inf", "--lag-s inf: give seconds"),
    ],
    "collect": [
        ("nowhere.csv -o new", "nowhere.csv: cannot be read"),
        ("random.csv -o new --namespace /x", "--namespace needs --ros"),
        ("random.csv -o new --yes-move-it", "--yes-move-it needs --ros"),
        ("random.csv -o new --ros 1 --twin peng2024", "--ros and --twin: give one of the two"),
        ("random.csv -o new --ros 1", "raven2:left, at up to 50 mm/s and 143.2 deg/s: agree"),
        ("random.csv -o random.csv/new", "is a file; name a folder"),
        ("random.csv -o new --seed -1", "greater than or equal to 0"),
        ("random.csv -o new --twin pipe", "pipe: is not a file"),
        ("random.csv -o new --robot pipe.toml", "pipe.toml: is not a file"),
        ("jaw.csv -o new", "jaw"),
    ],
    "monitor --port 0": [
        ("--model none.st", "none.st: cannot be read"),
        ("random.parquet --seed 1", "--seed and RECORDING: give one of the two"),
        ("--metadata rate_hz=3", "--columns and --metadata need a recording"),
        ("--robot bros", "bros"),
        ("none.csv", "none.csv: no such file"),
        ("--ros 2 --follow way.csv", "--ros and --follow: give one of the two"),
        ("--truth /ext_jpos", "--truth needs --ros"),
    ],
    "check m.st": [
        ("", "name a RECORDING, or give --ros and --truth"),
        ("--ros 2", "--ros needs --truth"),
        ("--ros 2 --truth /t random.parquet", "--ros and RECORDING: give one of the two"),
        ("--ros 2 --truth /t --duration-s nan", "--duration-s nan: give 1 to 600 s"),
        ("random.parquet --duration-s 3", "--duration-s needs --ros"),
    ],
    "study": [
        ("directions --jobs 2 --cluster tcp://127.0.0.1:9", "--cluster and --jobs: give one"),
        ("nosuch", "no study called 'nosuch'"),
        ("all --set networks=1", "--set is of one study"),
        ("forceps --set specimen=B", "name it in place of 'forceps'"),
        ("forceps-unloaded --set specimen", "write OPTION=VALUE"),
        ("forceps-unloaded --set specimen=A --set specimen=B", "specimen was given before"),
    ],
    "teleop": [
        ("--robot forceps", "teleop reads keys from a terminal"),
        ("--go-to elbo=80", "no joint called 'elbo'; did you mean 'elbow'?"),
        ("--go-to elbow=far", "'far' is no number"),
        ("--go-to elbow=nan", "--go-to elbow=nan: give a finite number of deg"),
        ("--go-to elbow=500", "elbow at 500 deg is outside its range [45, 135] deg"),
        ("--go-to elbow=80 --ros 2", "agree in a terminal, or give --yes-move-it"),
    ],
    "doctor run.parquet": [
        ("--duration-s 3", "--duration-s and --ros are for `truejoint doctor live`"),
        ("--ros 2", "--duration-s and --ros are for `truejoint doctor live`"),
    ],
    "": [
        ("nothing", "No such command 'nothing'"),
        ("touch nothing", "No such command 'nothing'"),
        ("show", "Missing argument"),
        ("fit run.csv", "No such command 'fit': `truejoint calibrate` fits a model"),
        ("bolt", "No such command 'bolt'. Did you mean `truejoint touch bolt`?"),
        ("touch calibrat", "No such command 'calibrat'. Did you mean 'calibrate'?"),
        ("calibrate --estimatr gp", "No such option: --estimatr (Possible options: --estimator"),
        ("robots raven", "did you mean 'raven2'?"),
        ("robots raven2:middle", "no arm"),
        ("estimators lin", "did you mean 'linear'?"),
        ("datasets kuka_kr30", "no data set called 'kuka_kr30'"),
        ("datasets --fetch", "--fetch needs NAME"),
        ("datasets kuka_kr300_dual_encoder:a*", "no recording fits 'a*'"),
        ("evaluate nowhere.st nowhere.parquet", "nowhere.st: cannot be read"),
        ("datasets nothing --fetch", "no data set called 'nothing'"),
        ("demo --sed 3", "No such option"),
        ("node simulate --robot forceps --quirks", "--quirks are those of raven2"),
    ],
}
# The same, of what is told only once something has been read.
LATER = {
    "correct m.st": [
        ("random.parquet -o a.csv --level 90", "states no interval; make one"),
        ("random.parquet zigzag.csv -o a.csv", "zigzag.csv"),
    ],
    "calibrate random.parquet -e linear -o new.st": [
        ("--fit-rate-hz 1e-308", "fit"),
        ("--redundant effort/elbow", "'effort/elbow' cannot check a measured position"),
    ],
    "show": [("pipe", "pipe: is not a file"), ("random.csv --columns pipe", "pipe: is not a file")],
    "collect jaw.csv -o . --robot forceps": [
        ("--state-rate-hz nan", "rate nan Hz"),
        ("--encoders x", "no encoders are stated for this robot"),
    ],
    "study -o new": [
        ("forceps-unloaded --set specimen=C", "C"),
        ("forceps-unloaded --set specimen=no/such.toml", "no/such.toml"),
        ("forceps-population --set count=0", "a population of 0"),
        ("forceps-population --preset tiny", "tiny"),
        ("forceps-loaded --set directions=up", "up"),
        ("forceps-loaded --set masses_g=3000", "a load of 3 kg"),
    ],
    "export m.st -o c": [("--to c --level 95", "states no interval; make one")],
}
BAGS = {
    "extract none.bag": [
        ("", "no such file"),
        ("--robot raven2", "without --out the topics are listed"),
        ("--offset-s 0", "without --out the topics are listed"),
        ("--near-s 0", "without --out the topics are listed"),
        ("-o a.parquet --near-s 1 --offset-s 1", "give one of the two"),
    ],
    "extract random.csv -o a.parquet": [("--state /x", "is no bag")],
    "doctor random.parquet": [("--truth /x", "is no bag, so it has neither profile nor topics")],
    "export random.parquet": [("--to bag -o a.zip", "call it .bag for ROS 1 or .mcap for ROS 2")],
}


def lines_of(table: dict[str, list[tuple[str, str]]]) -> list[tuple[str, str]]:
    return [(f"{begin} {end}".strip(), said) for begin, ends in table.items() for end, said in ends]


@pytest.fixture(scope="module")
def workplace(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the files of a session, pipes, files of keys, and a motion of another robot."""
    folder = tmp_path_factory.mktemp("workplace")
    for path in session.iterdir():
        (folder / path.name).symlink_to(path)
    for pipe in ("pipe", "pipe.toml"):
        os.mkfifo(folder / pipe)
    write_trajectory(Trajectory(("jaw",), ("rad",), [[0.0], [0.01]]), folder / "jaw.csv")
    for name, text in {
        "empty": "",
        "falls": "t_s,key,event\n0.5,1,press\n0.4,1,press\n",
        "long": "t_s,key,event\n0.5,12,press\n",
        "short": "t_s,key,event\nx\n",
    }.items():
        (folder / f"{name}.csv").write_text(text)
    return folder


@pytest.fixture
def refuse(call: Call, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Call a line that is wrong and makes nothing; gives all that was said."""
    monkeypatch.chdir(workplace)

    def run(line: str, said: str) -> str:
        before = set(workplace.rglob("*"))
        err = call.refuses(said, *shlex.split(line))
        assert set(workplace.rglob("*")) == before
        return err

    return run


@pytest.mark.parametrize(("line", "said"), lines_of(AT_ONCE))
def test_a_wrong_line_is_refused_before_anything_is_read(refuse, line, said):
    assert len(refuse(line, said).splitlines()) == 1


@pytest.mark.parametrize(("line", "said"), lines_of(LATER))
def test_what_does_not_fit_is_refused_in_the_last_line(refuse, line, said):
    refuse(line, said)


@pytest.mark.skipif(find_spec("rosbags") is None, reason="rosbags is not installed")
@pytest.mark.parametrize(("line", "said"), lines_of(BAGS))
def test_what_is_wrong_with_bags_is_refused(refuse, line, said):
    refuse(line, said)


@pytest.mark.parametrize(
    ("option", "wrong", "right"),
    [("--joint", "elbw", "elbow"), ("--feature", "rate(effort/elbw, 0.1)", "effort/elbow")],
)
def test_a_name_that_no_file_can_have_is_refused_after_the_first(
    call, session, option, wrong, right
):
    Path("unreadable.parquet").touch()
    files = f"{session}/zigzag.parquet unreadable.parquet"
    call.refuses(f"did you mean {right!r}?", f"calibrate {files} {option} '{wrong}' -o m.st")


@pytest.mark.parametrize("text", ["50,50", "(50, 50)", "[50,50]", "(50,50,)"])
def test_several_numbers_are_written_as_one_likes(text: str) -> None:
    estimator = configured("dnn", [f"hidden_layer_sizes={text}"])
    assert estimator.get_params()["hidden_layer_sizes"] == (50, 50)


@pytest.mark.parametrize("setting", ["epochs=1,2", "epochs=", "epochs", "hidden_layer_sizes=a"])
def test_a_setting_that_is_none_is_refused(setting: str) -> None:
    with pytest.raises(TruejointError, match="--set"):
        configured("dnn", [setting])


def test_the_package_runs_as_a_module(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["truejoint", "--version"])
    with pytest.raises(SystemExit) as stop:
        runpy.run_module("truejoint", run_name="__main__")
    assert not stop.value.code
    assert capsys.readouterr().out.startswith("truejoint ")


@pytest.mark.parametrize("name", ["[/x]", "[bold]run[/bold].csv", "\\[x]"])
def test_brackets_in_a_name_are_no_markup(call, session, name):
    call.refuses(name, "check", session / "m.st", name)
    folder = Path("[/y]")
    folder.mkdir(parents=True)
    (folder / "run.csv").write_bytes(b"t,measured/elbow\n")
    call.refuses("[/y]", f"check {session}/m.st [/y]/run.csv --robot raven2")
