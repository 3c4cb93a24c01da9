"""The exported C source, compiled without a warning, against the corrector."""

import math
import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.runtime.streams import faulty, ready

import truejoint
from truejoint.errors import ExportError, ModelFileError
from truejoint.estimators import NeuralNetwork, Polynomial
from truejoint.export.export_c import _named, check_prefix, comment, export_c, table
from truejoint.runtime import Status, Unlearnt

from .export_models import PLAIN, calibration, recording
from .library import STRICT, compile_c, expected, exported, needs_compiler

OPERATIONS = (
    "{}", "lag({}, 1)", "lag({}, 7)", "lowpass({}, 0.05)", "rate({}, 0.1)", "play({}, 0.02)",
)  # fmt: skip


@needs_compiler
@pytest.mark.parametrize(
    ("estimator", "signals", "joints", "how"),
    [(Polynomial(3), ("effort/roll",), ("elbow",), {"rezero": 10.0, "homing_ids": ()}),
     (Polynomial(0), ("measured/elbow", "measured/jaw1"), ("shoulder", "elbow", "insertion"),
      {"target": "position", "rezero": 0.0}),
     (NeuralNetwork(hidden_layer_sizes=(4, 1, 9)), ("effort/elbow",), ("elbow", "roll"), {})],
)  # fmt: skip
def test_source_does_what_the_corrector_does(tmp_path, estimator, signals, joints, how):
    features = [operation.format(signal) for signal in signals for operation in OPERATIONS]
    model = calibration(estimator, features, joints, **how)
    library = exported(tmp_path, model)
    assert library.functions.check() == 0
    source = recording(model.loop_signals, 400, 1)
    samples = source.table[list(model.loop_signals)].to_numpy()
    noise = np.random.default_rng(1).normal(0, 1e-4, samples.shape)
    t, samples = faulty(source.t, samples + noise, 1)
    library.functions.start()
    given = library.run(t, samples, len(model.joints))
    for got, wanted in zip(given, expected(ready(model), t, samples), strict=True):
        np.testing.assert_array_equal(got, wanted)


@pytest.mark.parametrize(
    ("errors", "precision", "said"),
    [((-1e-9, 1e-9), "float", "in float, shoulder would be off by up to"),
     ((1.0, 2.0), "double", "only 0 of 1618 samples would be corrected")],
)  # fmt: skip
def test_a_source_whose_check_would_show_nothing_is_refused(tmp_path, errors, precision, said):
    model = calibration(Polynomial(0), PLAIN)
    model.model.arrays_["intercept"][:] = 0.0
    lower, upper = (model.model.arrays_["intercept"] + error for error in errors)
    domain = replace(model.training_domain, error_lower=lower, error_upper=upper)
    with pytest.raises(ExportError, match=said):
        export_c(replace(model, training_domain=domain), tmp_path, precision=precision)


REPORT = """
#include <stdio.h>
#include "m_error_model.h"
int main(void)
{
    static m_error_model model;
    const double at[1] = {0.2};
    double reported[1];
    m_error_model_init(&model);
    m_report(&model, 0.0, at, NULL, reported);
    printf("%.9f", reported[0]);
    return 0;
}
"""


@needs_compiler
@pytest.mark.parametrize("precision", ["double", "float"])
def test_an_error_model_reports_in_either_precision(tmp_path, precision):
    t = 0.02 * np.arange(1500)
    position = 0.4 * np.sin(0.5 * t) + 0.3 * np.sin(1.3 * t)
    columns = {"t": t, "measured/jaw": position, "truth/jaw": 0.98 * position + 0.01}
    recorded = truejoint.Recording.from_columns(columns, "davinci_grasper")
    learnt = truejoint.calibration.learn_error_model(recorded, "linear")
    export_c(learnt, tmp_path, prefix="m", precision=precision)
    (tmp_path / "main.c").write_text(REPORT)
    sources = [tmp_path / "main.c", tmp_path / "m.c"]
    compile_c(sources, tmp_path / "run", "-std=c99", *STRICT, "-O1")
    said = subprocess.check_output([tmp_path / "run"], text=True)  # noqa: S603  # our own
    python = truejoint.runtime.ErrorModel(learnt, noisy=False).step(0.0, [0.2])
    assert float(said) == pytest.approx(python[0], abs=1e-6)


def test_vectors_hold_every_status_and_the_header_explains_them(tmp_path):
    export_c(calibration(Polynomial(3), PLAIN), tmp_path, prefix="m")
    text = (tmp_path / "m_vectors.h").read_text()
    unlearnt, statuses = np.array(
        re.findall(r"\{\d, \d, -?\d, (\d), [^{]*\{[^}]*\}, (\d+), \{", text), int
    ).T
    assert np.bitwise_or.reduce(statuses) == ~(Status.WRONG_SIZE | Status.OTHER_THREAD)
    assert np.bitwise_or.reduce(unlearnt) == ~Unlearnt.LEARNT
    assert (statuses == 0).sum() > 100
    offset = re.search(r"vector_offset\[\d\] = \{(.*)\}", text)[1]  # or re-zeroing showed nothing
    assert all(float(value) for value in offset.split(","))
    header = (tmp_path / "m.h").read_text()
    for status in set(Status) - {Status.WRONG_SIZE, Status.OTHER_THREAD}:
        assert re.search(rf"M_{status.name} = {int(status)},? /\* \w.*\w \*/", header)
    for warning in Unlearnt:
        assert f"M_UNLEARNT_{warning.name} = {int(warning)}" in header
        assert f"/* {warning.words} */" in header


def test_nothing_is_overwritten_unless_told(tmp_path):
    model = calibration(Polynomial(1))
    paths = export_c(model, tmp_path / "new" / "folder")
    assert [path.name for path in paths] == [
        "raven2_left.h", "raven2_left.c", "raven2_left_vectors.h", "raven2_left_check.c",
    ]  # fmt: skip
    before = [path.read_bytes() for path in paths]
    paths[0].unlink()
    with pytest.raises(ExportError, match="exists"):
        export_c(model, paths[0].parent, precision="float")
    assert not paths[0].exists()
    assert [path.read_bytes() for path in paths[1:]] == before[1:]
    export_c(model, paths[0].parent, overwrite=True)
    assert [path.read_bytes() for path in paths] == before
    assert sorted(paths[0].parent.iterdir()) == sorted(paths)


def test_a_level_that_is_no_share_is_refused(tmp_path):
    with pytest.raises(ExportError, match="level 3 is not a share between 0 and 1"):
        export_c(calibration(Polynomial(0)), tmp_path, level=3)


@pytest.mark.parametrize("prefix", ["", "1arm", "_arm", "a__b", "arm_", "a-b", "a b", "a/b", "é",
                                    "a\n", "a" * 41, "../x"])  # fmt: skip
def test_bad_prefixes_are_refused(tmp_path, prefix):
    with pytest.raises(ExportError, match="prefix") as caught:
        export_c(calibration(Polynomial(0)), tmp_path, prefix=prefix)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@given(st.from_regex(r"[a-z]([a-z0-9]|_[a-z])*", fullmatch=True).filter(lambda s: len(s) <= 40))
def test_good_prefixes_pass(prefix):
    assert check_prefix(prefix) == prefix


def test_what_cannot_be_exported_is_refused_in_one_line(tmp_path):
    model = calibration(Polynomial(1), rezero=0.0)
    cases = [
        (ExportError, "double' or 'float", {"precision": "half"}, model),
        (ExportError, "95 %", {"level": 0.95}, model),
        (ModelFileError, "calibrate it again", {}, replace(model, training_domain=None)),
    ]
    model.model.arrays_["coef"][0, 0] = 1e200
    cases.append((ExportError, "export in double", {"precision": "float"}, model))
    for error, said, options, bad in cases:
        with pytest.raises(error, match=said) as caught:
            export_c(bad, tmp_path, **options)
        assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("precision", "width"), [("double", 64), ("float", 32)])
@given(data=st.data())
def test_numbers_are_exact(precision, width, data):
    value = data.draw(st.floats(width=width, allow_subnormal=precision == "double"))
    text = table([value], precision).strip("{f}")
    got = float(text.replace("NAN", "nan").replace("INFINITY", "inf"))
    got = got if precision == "double" else float(np.float32(got))
    np.testing.assert_array_equal(got, value)
    assert math.isnan(value) or math.copysign(1, got) == math.copysign(1, value)


def test_names_that_would_be_one_in_c_are_numbered():
    named = _named(("measured/a_b", "measured_a/b", "effort/a"), str)
    identifiers = ["MEASURED_A_B_0", "MEASURED_A_B_1", "EFFORT_A"]
    assert [each["identifier"] for each in named] == identifiers


@given(st.text())
def test_no_text_ends_a_comment(text):
    safe = comment(text)
    assert safe.isascii()
    assert not set(safe) & set('*\\?"\n\r#')


@needs_compiler
def test_texts_of_a_model_file_stay_in_comments(tmp_path):
    model = calibration(Polynomial(1), homing_ids=["*/ int homing; /*", "??/\n"])
    evil = dict.fromkeys(model.units, "*/ }; int unit = 1; /* \\")
    model = replace(model, units=evil).with_metadata(data_sha256="*/\n#error hash\n/*")
    assert exported(tmp_path, model).functions.check() == 0
