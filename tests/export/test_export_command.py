"""`truejoint export`."""

import json

import pytest
import typer
from typer.testing import CliRunner

from truejoint.calibration import write_calibration
from truejoint.cli.export import export
from truejoint.cli.options import described
from truejoint.errors import ExportError
from truejoint.estimators import Polynomial

from .export_models import calibration

app = typer.Typer()
app.command()(described(export))


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.tj"
    write_calibration(calibration(Polynomial(1)), path)
    return path


def run(*words: object):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_c_source_is_written_where_asked_and_the_check_is_named(model, tmp_path):
    words = (model, "--to", "c", "--out", tmp_path / "c", "--prefix", "arm")
    result = run(*words, "--json")
    assert result.exit_code == 0, result.output
    files = json.loads(result.output)["files"]
    assert sorted(files) == sorted(str(path) for path in (tmp_path / "c").iterdir())
    assert isinstance(run(*words).exception, ExportError)  # nothing is overwritten
    result = run(*words, "--force", "--precision", "float")
    assert result.exit_code == 0, result.output
    assert "arm_check.c -lm -o check && ./check" in result.output.replace("\n", "")
    assert "float" in (tmp_path / "c" / "arm.c").read_text()


def test_onnx_graph_is_written_where_asked(model, tmp_path):
    pytest.importorskip("onnx", reason="the extra [onnx] is not installed")
    result = run(model, "--to", "onnx", "--out", tmp_path / "onnx")
    assert result.exit_code == 0, result.output
    assert [path.name for path in (tmp_path / "onnx").iterdir()] == ["raven2_left.onnx"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--to", "onnx", "--level", "90"), "work only with --to c"),
        (("--to", "onnx", "--prefix", "a b"), "prefix"),
    ],
)
def test_a_wrong_call_is_refused(model, tmp_path, words, said):
    result = run(model, *words, "--out", tmp_path / "out")
    assert isinstance(result.exception, ExportError)
    assert said in str(result.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", [("--to", "rust"), ("--to", "c", "--precision", "half")])
def test_a_wrong_choice_is_refused_before_the_model_is_read(tmp_path, words):
    result = run(tmp_path / "none", *words, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert repr(words[-1]) in result.output
