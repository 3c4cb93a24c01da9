"""Whatever is typed or lies in a file: one line, the right exit code, nothing that steers."""

import io
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import truejoint
from truejoint.cli import app, show
from truejoint.cli.console import one_line
from truejoint.errors import printable
from truejoint.recordings import Provenance

HUGE = "9" * 400
ENDLESS = "9" * 5000


@given(st.text())
def test_what_is_printed_steers_no_terminal(text: str) -> None:
    shown = printable(text)
    assert all(c in "\t\n" or c.isprintable() or ord(c) > 0x9F for c in shown)
    shown.encode()
    assert printable(shown) == shown
    assert "\n" not in one_line(text)


def test_a_long_text_is_cut_in_the_middle() -> None:
    line = one_line("a" * 5000 + "z" * 5000)
    assert len(line) < 1100
    assert line.startswith("aaa")
    assert line.endswith("zzz")


@pytest.mark.parametrize("name", ["esc\x1b[31m.csv", "bad\udcff.csv", "two\nlines.csv", ":x:.csv"])
def test_a_name_is_shown_as_it_is_but_for_what_steers(call, tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    shown = printable(name) if "\n" not in name else "two lines"
    assert "\x1b" not in call.refuses(shown, "show", tmp_path / name)


def test_a_name_that_is_no_utf8_is_read_and_written(call, session, tmp_path):
    recording, model = tmp_path / "r\udcff.parquet", tmp_path / "m\udcff.st"
    recording.write_bytes((session / "random.parquet").read_bytes())
    model.write_bytes((session / "m.st").read_bytes())
    text = tmp_path / "c\udcff.csv"
    text.write_text("t,measured/elbow\n0.0,0.1\n0.1,0.2\n")
    for arguments in (
        ("show", recording), ("show", model),
        ("correct", model, recording, "-o", tmp_path / "o\udcff.csv"),
        ("correct", model, recording, "-o", tmp_path / "o\udcff.parquet"),
        ("extract", recording, "-o", tmp_path / "x\udcff.parquet"),
        ("evaluate", model, recording, "--report", tmp_path / "e\udcff.html"),
        ("columns", text, "--robot", "raven2", "-o", tmp_path / "t\udcff.toml"),
    ):  # fmt: skip
        result = call(*arguments)
        assert result.code in {0, 1}, result.err
        assert "\udcff" not in result.out + result.err
    assert b"\\xff" in (tmp_path / "e\udcff.html").read_bytes()
    assert len(list(tmp_path.iterdir())) == 8


def test_what_cannot_be_read_is_named_and_a_long_list_is_cut(call):
    call.refuses("truejoint: /proc/self/mem: cannot be read", "show /proc/self/mem")
    forty = {"homings": [f"h{k}" for k in range(40)], "interval_sessions": [{"load": 0.0}] * 40}
    texts = dict(show._texts(forty))
    assert texts["homings"].endswith("h11 and 28 more (--json)")
    assert texts["interval_sessions"] == "40"


def test_a_session_of_half_a_character_goes_into_any_output(call, session):
    options = ("--metadata", "session=\ud800[/b]", "--metadata", "homing_id=\x1b]0;title\x07")
    recording = session / "random.parquet"
    for result in (
        call("correct", session / "m.st", recording, *options, "-o", "c.csv"),
        call("show", recording, *options),
    ):
        assert result.code in (0, 1), result.err
        assert "\x1b" not in result.out + result.err
    provenance = Provenance("bros", session="\ud800", source="bad\udcff.csv")
    assert (provenance.session, provenance.source) == ("\\ud800", "bad\\udcff.csv")


def test_output_in_forced_ascii(call, session, tmp_path, monkeypatch):
    model = tmp_path / "modèle.st"
    model.write_bytes((session / "m.st").read_bytes())
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")  # as PYTHONIOENCODING has it
    monkeypatch.setattr(sys, "stdout", out)
    call.good("show", model)
    out.flush()
    assert b"mod\\xe8le.st" in out.buffer.getvalue()
    assert b"raven2" in out.buffer.getvalue()


MAP = 'robot = "raven2"\n[columns]\nt = { column = "t", unit = "s" }\n"measured/elbow" = '


@pytest.mark.parametrize(
    "number", [HUGE, ENDLESS, "1e999", "nan", "-inf", "0", "1e308", "true", "'1'"]
)
def test_no_number_of_a_map_goes_unbounded(call, number):
    Path("run.csv").write_text("t,a\n0,0.1\n1,0.2\n")
    Path("map.toml").write_text(f'{MAP}{{ column = "a", scale = {number} }}\n')
    said = call.refuses("map.toml", "show run.csv --columns map.toml")
    assert "Error" not in said.splitlines()[-1]


def test_a_form_feed_in_a_comment_loses_no_row(call):
    content = b"# page\x0cbreak\x0b\xc2\x85\nt,measured/elbow\n" + b"0,1\n1,2\n2,3\n"
    Path("run.csv").write_bytes(content)
    call.good("show run.csv --robot raven2")
    read = truejoint.read_recording("run.csv", robot="raven2")
    assert np.array_equal(read.column("measured/elbow"), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (ZeroDivisionError("by 0\nhere"), 70, "ZeroDivisionError: by 0 here. This is a fault of"),
        (MemoryError(), 2, "takes more memory than there is"),
        (OSError(28, "No space left on device", "a"), 2, "a: the disk is full; make room"),
        (KeyboardInterrupt(), 130, "truejoint: stopped"),
    ],
)
def test_the_last_resort_is_one_line(call, monkeypatch, error, code, says):
    monkeypatch.setattr("truejoint.cli.commands.built", lambda: Mock(side_effect=error))
    result = call("show x")
    assert result.code == code
    assert says in result.err
    assert len(result.err.splitlines()) == 1
    result = call("show", "x", app.DEBUG)
    assert result.code == code
    assert "Traceback" in result.err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


class Strikes:
    """Is interrupted as it goes, when Python cannot raise."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupt_that_is_swallowed_is_remembered(call, monkeypatch):
    def swallows(*_: object, **__: object) -> None:
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)

    printed: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", printed.append)
    for swallow in (swallows, lambda *_, **__: Strikes() and None):
        monkeypatch.setattr("truejoint.cli.commands.built", lambda swallow=swallow: swallow)
        assert call("show x").code == 130
    assert not printed


def test_ctrl_c_while_modules_are_imported_ends_at_once() -> None:
    package = Path(truejoint.__file__).parents[1]
    program = (
        f"import sys; sys.path.insert(0, {str(package)!r}); import truejoint.cli.app as app\n"
        "large = {'ast', 'lazy_loader', 'numpy', 're', 'typer', 'typing'} & set(sys.modules)\n"
        "print(*large, flush=True)  # before it looks after Ctrl-C\n"
        "import os, signal, site; site.main()\n"
        "class Strikes:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'truejoint.cli.commands': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Strikes())\n"
        "app.main()\n"
    )
    ended = subprocess.run([sys.executable, "-S", "-c", program], capture_output=True, check=False)  # noqa: S603
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, b"\n", b"")
