"""What runs of an estimator: its rules, its fitted arrays, and one compiled row.

A `Family` needs numpy and numba alone, so a control loop gets by without what learns. Whatever an
estimator does once it is fitted follows from its row: predicting a recording, stepping in the
loop, and the C source.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, Final, Literal, cast, get_args

import numpy as np
from numba import types
from numba.extending import intrinsic

from truejoint.array_types import Array, Integers
from truejoint.compiled import INTEGERS, VECTOR, address, call_address, compiled
from truejoint.errors import CalibrationError
from truejoint.estimators.registry import FAMILIES
from truejoint.estimators.rules import Params, Rule, check_rules
from truejoint.layout import Memory
from truejoint.plugins import load_plugin, plugins

Shape = tuple[int, ...]
Path = tuple[str, ...]
Target = Literal["error", "position"]

TARGETS: Final[tuple[Target, ...]] = get_args(Target)
ROW: Final = types.void(INTEGERS, VECTOR, types.float64, VECTOR, VECTOR, VECTOR)
"""Signature of a row: see `Family.row`."""


@dataclass(frozen=True, eq=False)
class EstimatorData:
    """A fitted estimator as data: what a model file holds."""

    family: str  # a name that `find_family` knows
    params: Params  # as JSON values or tuples of them
    arrays: Mapping[str, Array]  # what was learnt, float64

    @property
    def kind(self) -> "Family":
        """The family, with the fields that the parameters decide."""
        return find_family(self.family).of(self.params)


_SPECIALISED: "Final[dict[tuple[str, str], Family]]" = {}
"""Families by their name and the text of parameters that follow the rules: see `Family.of`."""


@dataclass(frozen=True)
class Family:
    """One kind of estimator, as far as it runs.

    `find_family` finds it by its `name`, which stands in model files. `rules` say what each
    parameter must be; `shapes` gives name and shape of each learnt array, of parameters, number of
    features and number of outputs, and `pack` the memory of the row, of parameters, arrays and both
    numbers; they raise CalibrationError (`pack` FilterError too) for what the estimator does not
    take or makes no model.

    ``row(numbers, memory, dt, x, out, half_width)``, compiled, predicts `out` (n_outputs,) for the
    features `x` (k,); NaN where the model knows that it has none. `dt` is the time since the row
    before [s], 0 where a history starts. `half_width` (n_outputs,) is that of the calibration; a
    model that knows better overwrites it: its layout then has a scalar ``deviations``, by which the
    row multiplies its own; a NaN says that the model was cut off at what it was fitted to, and
    makes the sample OUT_OF_DOMAIN. Without row and `pack`, it only works offline.
    """

    name: str
    rules: Mapping[str, Rule]
    shapes: Callable[[Params, int, int], dict[str, Shape]]
    pack: Callable[[Params, Mapping[str, Array], int, int], Memory] | None = None
    row: Any = None
    remembers: bool = False  # whether an output depends on the rows before
    counts_samples: bool = False  # whether what was learnt belongs to one time step
    inputs: Callable[[Params], tuple[str, ...]] | None = None  # features, in order; None: any
    targets: tuple[Target, ...] = TARGETS  # what it can be fitted to, the usual one first
    states_deviation: Callable[[Params], bool] = lambda _params: False  # whether it has its own
    beside: Callable[[Params], Mapping[str, Path]] = lambda _params: {}
    """Quantities that the row tells beside the position, in SI units, each with the parts of its
    layout, outermost first, in the last of which (of none: in its own) it stands: an array of that
    name, (2,), of the value and its half-width, ``beside_deviations`` of the model's own."""
    bears_load: Callable[[Params], bool] = lambda _params: False
    """Whether it still holds where a load moves the joint off what its motor says, so that signals
    that disagree more than in training are no fault."""
    offline: str = "uses later rows"  # why there is no row, where there is none
    specialise: Callable[[Params], Mapping[str, Any]] | None = None
    """Fields of the family that the parameters decide."""

    def __reduce__(self) -> "tuple[Callable[[str], Family], tuple[str]]":
        return find_family, (self.name,)  # pickled, by an estimator that holds it, by its name

    def of(self, params: Params) -> "Family":
        """Give the family with what these parameters decide; CalibrationError if one is wrong."""
        if self.specialise is None:
            return self
        key = self.name, repr(params)  # the text tells 1 from 1.0 and True
        if key not in _SPECIALISED:
            self.check_params(params)
            _SPECIALISED[key] = replace(self, **self.specialise(params))
        return _SPECIALISED[key]

    def check_params(self, params: Params) -> None:
        """Raise CalibrationError, naming parameter, value and rule, when one breaks its rule."""
        if set(params) != set(self.rules):
            raise CalibrationError(
                f"{self.name} has parameters {sorted(params)}; it needs {sorted(self.rules)}"
            )
        check_rules(self.name, self.rules, params)

    def check_size(self, params: Params, n_features: int) -> None:
        """Raise CalibrationError unless there are as many features as it takes."""
        inputs = self.inputs(params) if self.inputs else None
        if inputs is not None and len(inputs) != n_features:
            raise CalibrationError(
                f"{self.name} takes {len(inputs)} features, in the order of {', '.join(inputs)}; "
                f"{n_features} are given"
            )

    def check(self, data: EstimatorData, n_features: int, n_outputs: int) -> None:
        """Raise CalibrationError when parameters or arrays are not those of the family."""
        self.check_params(data.params)
        self.check_size(data.params, n_features)
        shapes, arrays = self.shapes(data.params, n_features, n_outputs), data.arrays
        if set(shapes) != set(arrays):
            raise CalibrationError(
                f"{self.name} has arrays {sorted(arrays)}; it needs {sorted(shapes)}"
            )
        for name, shape in shapes.items():
            array = arrays[name]
            if array.shape != shape or array.dtype != np.float64:
                raise CalibrationError(
                    f"{self.name} array {name!r} is {array.dtype} {array.shape}; "
                    f"it must be float64 {shape}"
                )
            if not np.isfinite(array).all():
                raise CalibrationError(f"{self.name} array {name!r} is not finite")

    def memory(self, data: EstimatorData, n_features: int, n_outputs: int) -> Memory:
        """Memory of the row of a fitted estimator; CalibrationError if its numbers make none."""
        if self.pack is None:
            raise CalibrationError(
                f"estimator {self.name!r} {self.offline} and cannot run in a loop; it corrects "
                "recordings only"
            )
        return self.pack(data.params, data.arrays, n_features, n_outputs)

    def row_address(self) -> int:
        """Address of the compiled row; compiles it, or takes it from disk."""
        return address(self.row, ROW)


def only_joint(name: str, shapes: Mapping[str, Shape], n_outputs: int) -> dict[str, Shape]:
    """Give shapes of an estimator of one joint; raises CalibrationError for another number."""
    if n_outputs != 1:
        raise CalibrationError(f"{name} estimates one joint, not {n_outputs}")
    return dict(shapes)


def find_family(name: str) -> Family:
    """Family by the name that stands in model files; raises CalibrationError if there is none.

    It stands in the folder that its name begins with, or in another package's entry point in the
    group ``truejoint.models``.
    """
    if name in FAMILIES:
        folder, _, further = name.partition(".")
        module = import_module(f"{__package__}.{folder}.run")
        return cast("Family", getattr(module, further.upper() or "FAMILY"))
    points = plugins("truejoint.models")
    if name in points:
        return cast("Family", load_plugin(points[name], Family))
    raise CalibrationError(
        f"no estimator family {name!r:.60}; update truejoint, or install the package that brings it"
    )


def evaluate(
    family: Family, memory: Memory, X: Array, dt: Sequence[float] | Array, n_outputs: int
) -> Array:
    """Predict (n, n_outputs) for finite rows `X` (n, k), `dt` (n,) [s] after those before."""
    out, steps = np.empty((len(X), n_outputs)), np.asarray(dt, dtype=np.float64)
    rows, half_width = np.ascontiguousarray(X), np.full(n_outputs, np.inf)
    run_rows(family.row_address(), memory.numbers, memory.memory, steps, rows, out, half_width)
    return out


@intrinsic
def call_row(
    _typing: Any, function: Any, numbers: Any, memory: Any, dt: Any, x: Any, out: Any, width: Any
) -> Any:
    """Call the row at an address."""
    return types.void(types.int64, *ROW.args), call_address


@compiled
def run_rows(
    row: int, numbers: Integers, memory: Array, dt: Array, X: Array, out: Array, half_width: Array
) -> None:
    """Predict every row of `X` (n, k), one after the other, into `out` (n, n_outputs)."""
    for i in range(X.shape[0]):
        call_row(row, numbers, memory, dt[i], X[i], out[i], half_width)
