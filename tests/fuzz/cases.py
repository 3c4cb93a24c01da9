"""Random cases: damaged files and odd words for every option of every command, odd values for
public functions, messages of ROS, frames of the monitor's socket.

A case is a number and a seed: the same two give the same case.
"""

import ast
import contextlib
import gzip
import inspect
import io
import json
import operator
import os
import re
import shutil
import signal
import sys
import tempfile
import textwrap
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import scipy.io
from tests.recordings.damaged import KINDS as RECORDINGS
from tests.recordings.damaged import read_damaged
from tests.synthetic import build_recording

import truejoint
from truejoint.cli.app import main
from truejoint.cli.commands import COMMANDS, command
from truejoint.crtk.messages import PROFILES, joint_state_columns
from truejoint.errors import TruejointError
from truejoint.monitor.access import check_message
from truejoint.motion import read_trajectory, write_trajectory, zigzag
from truejoint.recordings import write_bag
from truejoint.recordings.table.stream_file import StreamWriter

NUMBERS = (
    "0", "-1", "1", "2", "0.5", "1e-308", "1e308", "1e999", "-1e999", "nan", "inf", "-inf",
    "5e-324", "9" * 20, "9" * 400, "9" * 5000, "0x10", "1_000", "1e", "--1", "1,5", "1/0", "1/3",
    "\u0663", "",
)  # fmt: skip
TEXTS = (
    "", " ", "a", "a" * 5000, "jaw", "elbow", "linear", "raven2", "left", "deg", "rad", "null",
    "a=b", "=", "jaw=1", "jaw=nan", "measured/elbow", "play(measured/elbow, nan)", "lowpass(",
    "lag(effort/elbow, -1)", "lag(measured/elbow, 999999999)", "((((", "[/x]", "[bold]", "[]", "{}",
    "\x1b[31m", "\udcff", "\u00e9", "\n", "\x00", "\\", "../..", "nosuch/m", ".", "%s", "{0}", "*",
    "?", "-", "--", "@",
)  # fmt: skip
TOKENS = (
    *(text.encode("utf-8", "surrogateescape") for text in (*NUMBERS, *TEXTS)), b"\x0c", b"\r",
    b"\xff\xfe", b"\xef\xbb\xbf", b"\n\n\n", b"\x00" * 64, b"\xff" * 8, b"\x7f" * 4, b",,,,",
    b"# ", b'"', b"[[", b"]]",
    b"\\ud800",
)  # fmt: skip
LEFT_OUT = {"datasets", "demo", "study"}
"""Commands that fetch what is public, or start threads and processes of their own for minutes."""
STOPPED = {"monitor": 3.0, "node correct": 2.0, "node simulate": 2.0,
           "node record": 2.0, "node encoders": 2.0, "doctor": 5.0, "touch run": 3.0,
           "teleop": 3.0, "collect": 30.0}  # fmt: skip
"""Commands that take long or run until they are stopped: Ctrl-C after so many seconds."""
FRAMES = tuple(
    msgspec.msgpack.encode(message) for message in (
        {"type": "GuiUpdateMessage", "uuid": "0" * 36, "updates": {"value": True}},
        {"type": "ViewerCameraMessage", "wxyz": [1.0, 0, 0, 0], "position": [0.0, 0, 1],
         "fov": 1.0, "near": 0.1, "far": 10.0, "image_height": 600, "image_width": 800,
         "look_at": [0.0, 0, 0], "up_direction": [0.0, 0, 1]},
    )
)  # fmt: skip
ODD_NAMES = ("\x1b[31m", "\udcff", "=1+1", "-x", " ", "\n", "\u202e")


def make_seeds(folder: Path) -> None:
    """Write one small good file of every kind that is read."""
    training, test = build_recording(400, 0), build_recording(300, 1)
    truejoint.write_parquet(training, folder / "training.parquet")
    truejoint.write_parquet(test, folder / "test.parquet")
    for name in ("linear", "poly2"):
        features = ("measured/elbow", "lowpass(effort/elbow, 0.1)")
        model = truejoint.calibrate(training, name, features=features, joints=["elbow"])
        truejoint.write_calibration(model, folder / f"{name}.safetensors")
    table = test.table[["t", "measured/elbow", "effort/elbow", "truth/elbow"]].head(60)
    table.to_csv(folder / "table.csv", index=False)
    text = (folder / "table.csv").read_bytes()
    (folder / "table.csv.gz").write_bytes(gzip.compress(text))
    rows = table.to_numpy()
    np.save(folder / "rows.npy", rows)
    np.savez(folder / "rows.npz", **{name.replace("/", "_"): table[name] for name in table})
    scipy.io.savemat(folder / "rows.mat", {"rows": rows, "t": rows[:, 0]})
    run("columns", folder / "table.csv", "--robot", "raven2", "-o", folder / "map.toml")
    robot = truejoint.get_robot("raven2")
    write_trajectory(zigzag(robot, "J2-J3", sparsity=0.5), folder / "zigzag.csv")
    positions = zigzag(robot, "J2-J3", sparsity=0.5).positions
    np.savetxt(folder / "lab.csv", positions, delimiter=",")
    for name in ("state.bag", "state.mcap"):
        write_bag(test.rows(test.t < test.t[0] + 2.0), folder / name)
    header = {"provenance": {"robot": "raven2"}, "robot": test.robot.to_dict(),
              "gap_limit": 0.1, "state_rate": None}  # fmt: skip
    writer = StreamWriter(folder / "run.stream", header)
    writer.write("state", test.t, {name: test.column(name) for name in table if name != "t"})
    writer.close()
    package = Path(truejoint.__file__).parent
    for path in ("robots/models/dvrk_psm.toml", "simulation/raven2/nominal.toml",
                 "simulation/forceps/b.toml"):  # fmt: skip
        shutil.copy(package / path, folder)


def run(*words: object) -> tuple[int, str]:
    """Call the command in this process: exit code, and what it said."""
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    err = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="backslashreplace")
    kept, code = sys.argv, 0
    sys.argv = ["truejoint", *map(str, words)]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        finally:
            sys.argv = kept
    for stream in (out, err):
        stream.seek(0)
    return code, out.read() + err.read()


@cache
def commands() -> dict[str, Any]:
    """Every command by the words that call it."""

    return {name: command(name) for name in COMMANDS if name not in LEFT_OUT}


class Draw:
    """What a case is made of, drawn at random."""

    def __init__(self, seed: int, number: int, seeds: Path, folder: Path) -> None:
        self.rng = np.random.default_rng([seed, number])
        self.seeds = sorted(seeds.iterdir())
        self.folder = folder
        self.covered: set[str] = set()  # what this case tries

    def chance(self, share: float) -> bool:
        """Be true that often."""
        return bool(self.rng.random() < share)

    def one(self, values: Any) -> Any:
        """Draw one of some values."""
        return values[int(self.rng.integers(len(values)))]

    def damaged(self, content: bytes) -> bytes:
        """Change a file here and there."""
        data = bytearray(content)
        for _ in range(int(self.rng.geometric(0.4))):
            at, n = (int(self.rng.integers(len(data) + 1)) for _ in range(2))
            at, end = min(at, n), min(max(at, n), at + 400)
            kind = int(self.rng.integers(8))
            if kind == 0 and data:
                data[at % len(data)] ^= 1 << int(self.rng.integers(8))
            elif kind == 1:
                del data[at:]
            elif kind == 2:
                del data[at:end]
            elif kind == 3:
                data[at:at] = data[at:end]
            elif kind == 4:
                data[at:at] = self.one(TOKENS)
            elif kind in {5, 6}:  # a number or a word becomes another
                words = list(re.finditer(rb"[-+.\w]+", bytes(data[:20_000])))
                if words:
                    word = self.one(words)
                    data[word.start() : word.end()] = self.one(TOKENS)
            elif data:
                data[at : at + 8] = self.rng.bytes(8)
        return bytes(data)

    def file(self) -> str:
        """Draw a file: damaged, good, or something else."""
        seed = self.one(self.seeds)
        if self.chance(0.1):
            return str(self.one((self.folder, "nosuch", "", *TEXTS)))
        if self.chance(0.35):  # a copy of it: what is called may write over it
            return shutil.copy(seed, self.folder)
        if self.chance(0.05):
            seed = seed.with_suffix(self.one(self.seeds).suffix)  # what it is not
        odd = self.one(ODD_NAMES) if self.chance(0.2) else str(self.rng.integers(10))
        path = self.folder / f"{odd}{seed.name}"
        source = seed if seed.exists() else self.one(self.seeds)
        self.covered.add(f"file {source.name}")
        path.write_bytes(self.damaged(source.read_bytes()))
        return str(path)

    def recording(self) -> Any:
        """Draw a recording, long or short."""
        path = next(path for path in self.seeds if path.name == "test.parquet")
        return truejoint.read_recording(path).rows(np.arange(self.one((2, 3, 20, 300))))

    def model(self) -> Any:
        """Give a calibration."""
        return truejoint.read_calibration(next(p for p in self.seeds if p.stem == "linear"))

    def number(self) -> float:
        """Draw a number that few expect."""
        return self.one((0.0, -1.0, 0.5, 1e308, 1e-308, np.nan, np.inf, -np.inf, 3.0, 1e15))

    def array(self) -> Any:
        """Draw an array of any shape."""
        shape = self.one(((0,), (1,), (3,), (3, 3), (0, 3), (20, 3), (2, 2, 2)))
        return np.full(shape, self.number()) if self.chance(0.5) else self.rng.normal(size=shape)

    def value(self, option: str) -> str:
        """Draw the value of an option."""
        if option in {"--out", "--report", "--plot", "--zero", "--rezero"}:
            ending = self.one((".html", ".parquet", ".csv", ".safetensors", ".toml", ".png", ""))
            return str(self.folder / f"out{ending}") if self.chance(0.8) else self.one(TEXTS)
        if option in {"--columns", "--robot", "--twin"} and self.chance(0.6):
            return self.file()
        return self.one(NUMBERS) if self.chance(0.5) else self.one(TEXTS)

    def call(self) -> list[str]:
        """Draw a command with its words."""
        name = self.one(sorted(commands()))
        self.covered.add(f"line {name}")
        words = name.split()
        options = []
        for parameter in commands()[name].params:
            option = parameter.opts[0]
            if not option.startswith("-"):
                count = 1 if parameter.nargs == 1 else int(self.rng.geometric(0.7))
                words += [self.file() for _ in range(count)]
            elif parameter.required or option == "--out" or self.chance(0.12):
                self.covered.add(f"option {name} {option}")
                options += [option] if parameter.is_flag else [option, self.value(option)]
        if name == "calibrate":
            options += ["-e", self.one(("offset", "linear", "poly2"))]
        return [word.replace("\x00", "") for word in (*words, *options)]


class Case(NamedTuple):
    """What a case is in words, what raises if it goes wrong, and what it covers."""

    what: str
    run: Callable[[], None]
    covered: set[str]


def command_case(draw: Draw) -> tuple[str, Callable[[], None]]:
    """Give a command that must end well or refuse in a line."""
    words = draw.call()

    limit = max((s for name, s in STOPPED.items() if words[:1] == name.split()[:1]), default=0.0)

    def case() -> None:
        if limit:
            signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGINT))
            signal.setitimer(signal.ITIMER_REAL, limit)
        code, said = run(*words)
        signal.setitimer(signal.ITIMER_REAL, 0)
        wanted = {0, 1, 2, 130} if limit else {0, 1, 2}
        assert code in wanted, f"exit code {code}: {said[-300:]}"
        assert "Traceback" not in said, said[-500:]
        if "--json" in words and code in {0, 1} and not limit:
            check_values(words, said)

    return f"truejoint {words!r}", case


def check_values(words: list[str], said: str) -> None:
    """Check that a document holds finite numbers alone, and, of what only reads, is made again."""

    def values(said: str) -> Any:
        document = json.JSONDecoder(parse_constant=operator.truediv)  # NaN and infinity are no JSON
        return document.raw_decode(said[said.index("{") :])[0]

    first = values(said)
    if not {"--out", "-o", "--report", "--plot"} & {*words}:
        assert values(run(*words)[1]) == first


KINDS: dict[str, Callable[[Draw], Any]] = {
    r"(Sequence|Iterable|list)\[Recording\]": lambda draw: [draw.recording(), draw.recording()],
    r"Recording( \| .*)?": lambda draw: draw.recording(),
    r"Calibration( \| .*)?": lambda draw: draw.model(),
    r"Robot": lambda draw: truejoint.get_robot("raven2"),
    r".*\bPath.*": lambda draw: draw.file(),
    r"bool": lambda draw: draw.chance(0.5),
    r"int( \| None)?": lambda draw: int(draw.one((0, -1, 1, 2, 7, 10**20, 2**31))),
    r"float( \| None)?": lambda draw: draw.number(),
    r"Array|ArrayLike|Sequence\[float\]": lambda draw: draw.array(),
    r"str( \| None)?": lambda draw: draw.one(TEXTS),
    r"(Sequence|Iterable|list|tuple)\[str.*\]": lambda draw: [draw.one(TEXTS)],
}
"""How a value of the kind that an annotation asks for is drawn."""


def value_of(annotation: str) -> Callable[[Draw], Any] | None:
    """How a value of an annotated kind is drawn, None for kinds that are not known."""
    return next((how for kind, how in KINDS.items() if re.fullmatch(kind, annotation)), None)


@cache
def draws_of(function: Callable[..., Any]) -> dict[str, tuple[Callable[[Draw], Any] | None, bool]]:
    """How each parameter is drawn, by its annotation in the source, and whether it is needed."""
    (source,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(source, ast.FunctionDef)
    arguments = [*source.args.posonlyargs, *source.args.args, *source.args.kwonlyargs]
    kinds = {a.arg: ast.unparse(a.annotation).strip("'") for a in arguments if a.annotation}
    parameters = inspect.signature(function).parameters.values()
    return {p.name: (value_of(kinds.get(p.name, "")), p.default is p.empty) for p in parameters}


@cache
def functions() -> dict[str, Callable[..., Any]]:
    """Public functions that take what can be drawn, by name."""
    found = {}
    for module in ("", "calibration", "evaluation", "features", "filters", "motion", "recordings",
                   "robots", "runtime", "simulation"):  # fmt: skip
        owner = getattr(truejoint, module) if module else truejoint
        for name in dir(owner):
            function = getattr(owner, name)
            own = inspect.isfunction(function) and function.__module__.startswith("truejoint")
            if own and all(how or not needed for how, needed in draws_of(function).values()):
                found[f"{function.__module__}.{name}"] = function
    return found


def function_case(draw: Draw) -> tuple[str, Callable[[], None]]:
    """Give a call of a public function that must work or say no as this project or Python does."""
    name = draw.one(sorted(functions()))
    function = functions()[name]
    draw.covered.add(f"function {name}")
    values = {}
    for parameter, (how, needed) in draws_of(function).items():
        if how and (needed or draw.chance(0.3)):
            values[parameter] = how(draw)

    def case() -> None:
        refused = TruejointError, TypeError, ValueError
        with contextlib.suppress(*refused), contextlib.redirect_stdout(io.StringIO()):
            function(**values)

    return f"{name}({str(values)[:600]})", case


def message_case(draw: Draw) -> tuple[str, Callable[[], None]]:
    """Give messages of ROS, as they arrive, that must become columns or be refused."""
    robot = truejoint.get_robot(draw.one(("raven2", "dvrk_psm", "davinci_grasper")))
    profile = PROFILES[draw.one(sorted(PROFILES))]
    quantity = draw.one(("measured", "setpoint", "truth"))
    rows, count = draw.one((0, 1, 3)), draw.one((0, 1, 3, 7, 16, 40))
    names = [draw.one((*robot.joint_names, *TEXTS)) for _ in range(draw.one((0, 1, count)))]
    fields = {
        name: np.full((rows, draw.one((0, count, count + 1))), draw.number())
        for name in ("position", "velocity", "effort")
    }
    draw.covered.add(f"message {quantity}")

    def case() -> None:
        with contextlib.suppress(TruejointError):
            columns = joint_state_columns(robot, quantity, names, fields, profile)
            assert all(values.shape == (rows,) for values in columns.values())

    return f"{robot.name} {quantity} {names!r:.200} {profile}"[:600], case


def frame_case(draw: Draw) -> tuple[str, Callable[[], None]]:
    """Give a thousand frames, damaged ones of the page's own, that pass or end the connection."""
    frames = [draw.damaged(draw.one(FRAMES)) for _ in range(1000)]
    draw.covered.add("frames")

    def case() -> None:
        for frame in frames:
            with contextlib.suppress(ValueError):
                check_message(frame)

    return f"frames {frames[0]!r:.200} ...", case


@cache
def contents() -> dict[str, bytes]:
    """Give a small recording of every kind, by suffix."""
    with tempfile.TemporaryDirectory() as folder:
        for suffix, (write, _) in RECORDINGS.items():
            write(Path(folder) / f"a{suffix}")
        return {suffix: (Path(folder) / f"a{suffix}").read_bytes() for suffix in RECORDINGS}


def read_model(path: Path, good: Path, test: Any) -> None:
    """Correct by a model that may be damaged as by the one of before."""
    model = truejoint.read_calibration(path)
    np.testing.assert_array_equal(
        model.correct(test), truejoint.read_calibration(good).correct(test)
    )


def read_way(path: Path, good: Path, _: Any) -> None:
    """Read a trajectory that may be damaged as the one of before."""
    way, whole = read_trajectory(path), read_trajectory(good)
    assert "hash" in way.meta.get("notes", "") or np.array_equal(way.positions, whole.positions)


def value_case(draw: Draw) -> tuple[str, Callable[[], None]]:
    """Give a damaged file whose numbers must be those of others' readers or of before, or none."""
    signed = {seed.name: seed for seed in draw.seeds if seed.suffix in (".safetensors", ".csv")}
    kind = draw.one((*contents(), "linear.safetensors", "zigzag.csv"))
    content = contents()[kind] if kind in contents() else signed[kind].read_bytes()
    path = draw.folder / (f"b{kind}" if kind in contents() else kind)
    path.write_bytes(draw.damaged(content))
    draw.covered.add(f"values {kind}")

    def case() -> None:
        if kind in contents():
            assert "\n" not in read_damaged(path, RECORDINGS[kind][1])
            return
        with contextlib.suppress(TruejointError):
            (read_model if kind.endswith("s") else read_way)(path, signed[kind], draw.recording())

    return f"values of {path.name}", case


CASES: dict[Callable[[Draw], Any], float] = {
    command_case: 0.66, function_case: 0.16, value_case: 0.12, message_case: 0.05,
    frame_case: 0.01,
}  # fmt: skip
"""Kinds of cases and the share of each."""


def make(seed: int, number: int, seeds: Path, folder: Path) -> Case:
    """Give a case by its number."""
    draw = Draw(seed, number, seeds, folder)
    kind = draw.rng.choice(len(CASES), p=list(CASES.values()))
    what, run_it = list(CASES)[kind](draw)
    return Case(what, run_it, draw.covered)


def everything(seeds: Path) -> set[str]:
    """All that cases can cover: options of commands, kinds of files, functions, messages."""
    options = {
        f"option {name} {parameter.opts[0]}"
        for name, one in commands().items()
        for parameter in one.params
        if parameter.opts[0].startswith("-")
    }
    files = {f"file {path.name}" for path in seeds.iterdir()}
    lines = {f"line {name}" for name in commands()}
    messages = {"frames", "message measured", "message setpoint", "message truth"}
    messages |= {f"values {kind}" for kind in (*contents(), "linear.safetensors", "zigzag.csv")}
    return options | files | lines | messages | {f"function {name}" for name in functions()}
