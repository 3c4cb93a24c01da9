"""Write a calibration's regressor as an ONNX graph."""

import json
import os
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.errors import ExportError
from truejoint.estimators.family import EstimatorData
from truejoint.estimators.polynomial.run import factors_of
from truejoint.estimators.stack.run import columns_of, members
from truejoint.export.export_c import Precision, check_precision, write_files
from truejoint.extras import require
from truejoint.files import check_ending

# Old enough for every run time of the last years; the operators used here have not changed since.
_OPSET: Final = 13
_IR_VERSION: Final = 8


def export_onnx(
    calibration: Calibration,
    path: str | os.PathLike[str],
    *,
    precision: Precision = "double",
    overwrite: bool = False,
) -> Path:
    """Write the regressor of a calibration as an ONNX graph; it checks no input and keeps no state.

    The output ``position`` (rows, n_joints) [rad or m] is what `Calibration.correct` gives. If
    every feature is the plain value of a signal, the input is ``sample`` (rows, n_signals): the
    values of `Calibration.signals`. Otherwise the caller computes the features: the inputs are
    ``features`` (rows, n_features) and, where the model predicts the error of the measured
    position, ``measured`` (rows, n_joints). The metadata name what stands in each column.

    Parameters
    ----------
    calibration : Calibration
    path : path-like
        File to write, usually ``.onnx``; its folder is made if it does not exist.
    precision : {"double", "float"}
        Precision of inputs, weights and output.
    overwrite : bool
        Whether a file at `path` may be replaced.

    Raises
    ------
    TruejointError
        If the package onnx is not installed.
    ExportError
        If the estimator is no regressor of features, or the file exists (without `overwrite`) or
        cannot be written.

    Examples
    --------
    >>> export_onnx(model, "jaw.onnx").name
    'jaw.onnx'
    """
    check_precision(precision)
    require("onnx.checker", "onnx", "an ONNX graph")
    onnx = require("onnx", "onnx", "an ONNX graph")
    path = Path(path)
    check_ending(path, ".onnx", "a graph", ExportError)
    model = _Graph(onnx, precision).build(calibration)
    write_files(path.parent, {path.name: model.SerializeToString()}, overwrite=overwrite)
    return path


class _Graph:
    """An ONNX graph under construction; names of values are the Python variables they replace."""

    def __init__(self, onnx: Any, precision: Precision) -> None:
        self._onnx = onnx
        self._dtype = np.float64 if precision == "double" else np.float32
        self._element = getattr(onnx.TensorProto, precision.upper())
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def build(self, calibration: Calibration) -> Any:
        """Build the checked model of a calibration."""
        feature_set = as_calibration(calibration).feature_set
        columns = {"features": feature_set.names}
        measured_signals = tuple(f"measured/{joint}" for joint in calibration.joints)
        features, measured = "features", "measured"
        if all(feature.operation == "value" for feature in feature_set.features):
            columns = {"sample": calibration.signals}
            features, measured = (
                "sample"
                if names == calibration.signals
                else self.columns("sample", [calibration.signals.index(name) for name in names])
                for names in (feature_set.signals, measured_signals)
            )
        elif calibration.target == "error":
            columns |= {"measured": measured_signals}
        described: Mapping[str, Any] = {
            **{name: getattr(calibration, name) for name in ("robot", "arm", "joints")},
            "units": dict(calibration.units),
            "features": feature_set.names,
            "training_range": np.column_stack([calibration.lower, calibration.upper]).tolist(),
            "gap_limit": calibration.gap_limit,
            "data_sha256": calibration.metadata.get("data_sha256", ""),
            **{f"columns_of_{name}": names for name, names in columns.items()},
        }
        predicted = self.predict(features, calibration.fitted, len(calibration.feature_set))
        if calibration.signal_shift.any():
            raise ExportError(
                "its inputs are re-zeroed, which the ONNX graph leaves out; export C, or the model "
                "before re-zeroing"
            )
        if calibration.output_shift.any():
            predicted = self.node("Add", [predicted, self.constant(calibration.output_shift)])
        is_error = calibration.target == "error"
        terms = [measured, predicted] if is_error else [predicted]
        self.node("Add" if is_error else "Identity", terms, "position")
        helper = self._onnx.helper
        make = helper.make_tensor_value_info
        inputs = [make(name, self._element, ["rows", len(c)]) for name, c in columns.items()]
        output = make("position", self._element, ["rows", len(calibration.joints)])
        graph = helper.make_graph(self._nodes, "truejoint", inputs, [output], self._constants)
        made_by = {"producer_name": "truejoint", "producer_version": version("truejoint")}
        opset = [helper.make_opsetid("", _OPSET)]
        model = helper.make_model(graph, opset_imports=opset, ir_version=_IR_VERSION, **made_by)
        properties = {f"truejoint.{k}": json.dumps(v) for k, v in described.items()}
        helper.set_model_props(model, properties)
        self._onnx.checker.check_model(model, full_check=True)
        return model

    def predict(self, features: str, data: EstimatorData, n_features: int) -> str:
        """Predict by an estimator; raises ExportError if it has no graph."""
        if data.family not in _BUILDERS:
            raise ExportError(
                f"estimator {data.family!r:.60} has no ONNX graph; known: {', '.join(_BUILDERS)}"
            )
        return _BUILDERS[data.family](self, features, data, n_features)

    def node(self, operator: str, inputs: list[str], output: str = "", **attributes: Any) -> str:
        """Add a node; returns the name of its output."""
        output = output or f"{operator}_{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [output], **attributes))
        return output

    def columns(self, source: str, indices: ArrayLike) -> str:
        """Choose columns of a value."""
        return self.node("Gather", [source, self.constant(np.asarray(indices, np.int64))], axis=1)

    def constant(self, values: ArrayLike) -> str:
        """Add numbers: integers as they are, others in the precision of the graph."""
        array = np.asarray(values)
        if array.dtype != np.int64:
            with np.errstate(over="ignore"):
                array = array.astype(self._dtype)
            if not np.isfinite(array).all():
                raise ExportError("a number of the model does not fit a float; export in double")
        name = f"constant_{len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def scaled(self, features: str, arrays: Mapping[str, Array]) -> str:
        """Standardise features."""
        centred = self.node("Sub", [features, self.constant(arrays["mean"])])
        return self.node("Mul", [centred, self.constant(arrays["inverse_scale"])])

    def affine(self, source: str, weight: Array, bias: Array) -> str:
        """Multiply with a matrix (inputs, outputs) and add a vector."""
        product = self.node("MatMul", [source, self.constant(weight)])
        return self.node("Add", [product, self.constant(bias)])


def _polynomial(graph: _Graph, features: str, data: EstimatorData, n_features: int) -> str:
    arrays = data.arrays
    terms = scaled = graph.scaled(features, arrays)
    factors = factors_of(data.params, n_features)
    if not len(factors):  # the features, weighted with zero, say how many rows there are
        intercept = arrays["intercept"]
        return graph.affine(features, np.zeros((n_features, len(intercept))), intercept)
    if factors.shape[1] > 1:
        missing = factors == n_features
        terms = ""
        for j in range(factors.shape[1]):
            chosen = graph.columns(scaled, np.where(missing[:, j], 0, factors[:, j]))
            if missing[:, j].any():  # a factor 1 where the term is of lower degree
                masked = graph.node("Mul", [chosen, graph.constant(1.0 - missing[:, j])])
                chosen = graph.node("Add", [masked, graph.constant(1.0 * missing[:, j])])
            terms = graph.node("Mul", [terms, chosen]) if terms else chosen
    return graph.affine(terms, arrays["coef"], arrays["intercept"])


def _network(graph: _Graph, features: str, data: EstimatorData, _n_features: int) -> str:
    arrays = data.arrays
    units = graph.scaled(features, arrays)
    n_layers = sum(name.startswith("weight_") for name in arrays)
    for i in range(n_layers):
        units = graph.affine(units, arrays[f"weight_{i}"], arrays[f"bias_{i}"])
        if i < n_layers - 1:
            units = graph.node("Sigmoid", [units])
    scaled = graph.node("Mul", [units, graph.constant(arrays["target_scale"])])
    return graph.node("Add", [scaled, graph.constant(arrays["target_mean"])])


def _combination(graph: _Graph, features: str, data: EstimatorData, n_features: int) -> str:
    weights, columns = data.arrays["weights"], columns_of(data.params, n_features)
    n_outputs = 1 + max(max(outputs) for _, outputs in members(data.params, data.arrays))
    total = ""
    for number, (member, outputs) in enumerate(members(data.params, data.arrays)):
        member_weights, weights = np.split(weights, [len(outputs)])
        spread = member_weights[:, None] * (np.array(outputs)[:, None] == np.arange(n_outputs))
        seen, beyond = features, ""
        if data.params["columns"]:
            start = sum(map(len, columns[:number]))
            ranges = slice(start, start + len(columns[number]))
            direct = data.arrays["direct"][number * n_features : (number + 1) * n_features]
            seen = graph.columns(features, columns[number])
            above = graph.node("Max", [seen, graph.constant(data.arrays["lower"][ranges])])
            held = graph.node("Min", [above, graph.constant(data.arrays["upper"][ranges])])
            slope = graph.constant(data.arrays["slope"][ranges][:, outputs])
            line = graph.node("MatMul", [graph.node("Sub", [seen, held]), slope])
            beside = graph.node("MatMul", [features, graph.constant(direct[:, outputs])])
            seen, beyond = held, graph.node("Add", [line, beside])
        predicted = graph.predict(seen, member, len(columns[number]))
        predicted = graph.node("Add", [predicted, beyond]) if beyond else predicted
        weighted = graph.node("MatMul", [predicted, graph.constant(spread)])
        total = graph.node("Add", [total, weighted]) if total else weighted
    return total


_BUILDERS: Final[Mapping[str, Callable[[_Graph, str, EstimatorData, int], str]]] = {
    "polynomial": _polynomial,
    "network": _network,
    "stack": _combination,
}
