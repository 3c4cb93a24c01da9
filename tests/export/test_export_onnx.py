"""The ONNX graph, run by onnxruntime, against the corrections that Python makes."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from tests.runtime.streams import recording as stream_recording
from tests.runtime.streams import trained

from truejoint.errors import ExportError, TruejointError
from truejoint.estimators import NeuralNetwork, Polynomial, Stack
from truejoint.export.export_onnx import export_onnx

from .export_models import HISTORY, PLAIN, calibration, recording

onnx = pytest.importorskip("onnx", reason="the extra [onnx] is not installed")
onnxruntime = pytest.importorskip("onnxruntime", reason="the extra [onnx] is not installed")

ESTIMATORS = (
    Polynomial(0), Polynomial(1), Polynomial(2), Polynomial(3),
    NeuralNetwork(hidden_layer_sizes=(9, 7, 5)),
)  # fmt: skip


def run(path, model, test) -> tuple[list[str], np.ndarray]:
    """Names of the inputs of an exported graph, and what it gives for a recording."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    columns = {
        "sample": test.table[list(model.signals)].to_numpy(),
        "features": model.feature_set.compute(test, model.gap_limit),
        "measured": test.columns("measured", model.joints),
    }
    types = {"tensor(double)": np.float64, "tensor(float)": np.float32}
    feed = {i.name: columns[i.name].astype(types[i.type]) for i in session.get_inputs()}
    return list(feed), session.run(["position"], feed)[0]


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=str)
@pytest.mark.parametrize("features", [PLAIN, HISTORY], ids=["plain", "history"])
@pytest.mark.parametrize("target", ["error", "position"])
def test_graph_gives_what_correct_gives(tmp_path, estimator, features, target):
    model = calibration(estimator, features, target=target)
    test = recording(model.signals, 100, 5)
    expected = model.correct(test)
    path = export_onnx(model, tmp_path / "m.onnx")
    with pytest.raises(ExportError, match="exists"):
        export_onnx(model, path, precision="float")
    inputs, position = run(path, model, test)
    if features == HISTORY:
        assert inputs == (["features", "measured"] if target == "error" else ["features"])
    else:
        assert inputs == ["sample"]
    np.testing.assert_allclose(position, expected, rtol=0, atol=1e-12)
    path = export_onnx(model, tmp_path / "m.onnx", precision="float", overwrite=True)
    _, position = run(path, model, test)
    assert position.dtype == np.float32
    np.testing.assert_allclose(position, expected, rtol=0, atol=1e-5)
    assert not np.allclose(position, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("how", [{}, {"sees": ((2, 0), (0, 1, 2)), "beside": ((), (1, 0))}])
def test_a_combination_is_the_graphs_of_its_members(tmp_path, how):
    tried = (Polynomial(1), NeuralNetwork(hidden_layer_sizes=(5,), epochs=2))
    model = trained(Stack(tried, ((0.25, 0.0), (0.75, 1.0)), **how))
    test = stream_recording(np.arange(0.0, 5.0, 1 / 30), seed=3)
    _, position = run(export_onnx(model, tmp_path / "m.onnx"), model, test)
    np.testing.assert_allclose(position, model.correct(test), rtol=0, atol=1e-12)
    with pytest.raises(ExportError, match="'trees' has no ONNX graph"):
        export_onnx(trained("linear_trees"), tmp_path / "t.onnx")


def test_metadata_name_the_columns(tmp_path):
    fitted = calibration(Polynomial(1), HISTORY, ("elbow",))
    model = onnx.load(export_onnx(fitted, tmp_path / "m.onnx"))
    said = {entry.key: json.loads(entry.value) for entry in model.metadata_props}
    assert said["truejoint.columns_of_features"] == list(fitted.feature_set.names)
    assert said["truejoint.columns_of_measured"] == ["measured/elbow"]
    assert (said["truejoint.robot"], said["truejoint.arm"]) == ("raven2", "left")
    ranges = np.array(said["truejoint.training_range"])
    np.testing.assert_array_equal(ranges, np.column_stack([fitted.lower, fitted.upper]))


def test_without_onnx_the_refusal_says_how_to_install_it(tmp_path, monkeypatch):
    fitted = calibration(Polynomial(0))
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(TruejointError, match=r'pip install "truejoint\[onnx\]"') as caught:
        export_onnx(fitted, tmp_path / "m.onnx")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_numbers_too_large_for_a_float_are_refused(tmp_path):
    made = calibration(Polynomial(0))
    arrays = {**made.fitted.arrays, "intercept": np.full(3, 1e39)}
    fitted = replace(made, fitted=replace(made.fitted, arrays=arrays))
    with pytest.raises(ExportError, match="export in double"):
        export_onnx(fitted, tmp_path / "m.onnx", precision="float")


def test_a_zero_of_the_output_is_in_the_graph_and_one_of_the_inputs_is_refused(tmp_path):
    model = calibration(Polynomial(1), PLAIN)
    test = recording(model.signals, 100, 5)
    zero = 0.01 * (1.0 + np.arange(len(model.joints)))
    later = model.shifted(zero)
    _, position = run(export_onnx(later, tmp_path / "m.onnx"), later, test)
    np.testing.assert_allclose(position, model.correct(test) + zero, rtol=0, atol=1e-12)
    inputs = replace(later, moves=np.ones((len(model.signals), len(model.joints))))
    with pytest.raises(ExportError, match="inputs are re-zeroed"):
        export_onnx(inputs, tmp_path / "n.onnx")
