"""The exported C source, compiled without a warning, against the corrector."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.runtime.streams import faulty, run

from truejoint.calibration.zero import Zero
from truejoint.errors import ExportError, ModelFileError
from truejoint.estimators import NeuralNetwork, Polynomial
from truejoint.export.export_c import check_prefix, comment, export_c, table
from truejoint.runtime import Corrector, Status, Unlearnt

from .export_models import HISTORY, PLAIN, calibration, recording
from .library import Library, expected, exported, needs_compiler


def random_stream(model, n: int, seed: int):
    """Stamps and samples of a smooth motion, with faults of every kind here and there."""
    source = recording(model.loop_signals, n, seed)
    samples = source.table[list(model.loop_signals)].to_numpy()
    noise = np.random.default_rng(seed).normal(0, 1e-4, samples.shape)
    return faulty(source.t, samples + noise, seed)


def assert_same_as_corrector(library: Library, model, n: int, seed: int) -> float:
    """Compare bit for bit on a random stream; returns the share of samples that are corrected."""
    t, samples = random_stream(model, n, seed)
    corrector = Corrector(model)
    corrector.set_homing(True, "h1")
    library.functions.start()
    given = library.run(t, samples, len(model.joints))
    for got, wanted in zip(given, expected(corrector, t, samples), strict=True):
        np.testing.assert_array_equal(got, wanted)
    return float((given[0] == 0).mean())


@needs_compiler
@settings(max_examples=6)
@given(data=st.data())
def test_source_does_what_the_corrector_does(tmp_path_factory, data):
    operations = [
        "{}", "lag({}, 1)", "lag({}, 7)", "lowpass({}, 0.05)", "rate({}, 0.1)", "play({}, 0.02)",
    ]  # fmt: skip
    signals = st.sampled_from(["measured/elbow", "effort/elbow", "effort/roll", "measured/jaw1"])
    texts = st.builds(str.format, st.sampled_from(operations), signals)
    features = data.draw(st.lists(texts, min_size=1, max_size=9, unique=True))
    joints = data.draw(st.sampled_from([("elbow",), ("shoulder", "elbow", "insertion", "roll")]))
    layers = st.lists(st.integers(1, 9), min_size=1, max_size=4)
    networks = st.builds(NeuralNetwork, hidden_layer_sizes=layers.map(tuple))
    model = calibration(
        data.draw(st.builds(Polynomial, st.integers(0, 3)) | networks),
        features,
        joints,
        data.draw(st.sampled_from(["error", "position"])),
        seed=data.draw(st.integers(0, 1000)),
        rezero=data.draw(st.sampled_from([None, 0.0, 10.0])),
        homing_ids=data.draw(st.sampled_from([("h1",), ()])),
    )
    library = exported(tmp_path_factory.mktemp("c"), model)
    assert library.functions.check() == 0
    assert_same_as_corrector(library, model, 400, data.draw(st.integers(0, 1000)))


@needs_compiler
@pytest.mark.parametrize("precision", ["double", "float"])
def test_source_warns_of_motion_as_the_corrector_does(tmp_path, precision):
    model = calibration(Polynomial(1), seed=2)
    moving = recording(model.loop_signals, 900, seed=2)
    samples = moving.table[list(model.loop_signals)].to_numpy().astype(np.float32).astype(float)
    samples[600:] = samples[599] + 0.7 * (samples[600:] - samples[600])
    t = np.array(moving.t)
    t = np.cumsum(np.diff(t, prepend=t[0]) * np.repeat([1.0, 0.34, 2.5], 300))
    library = exported(tmp_path, model, precision)
    library.functions.start()
    library.run(t, samples, len(model.joints))
    corrector, warned = Corrector(model), []
    corrector.set_homing(True, "h1")
    run(corrector, t, samples, lambda row: warned.append(int(corrector.unlearnt)))
    assert library.unlearnt[:-1].tolist() == warned[1:]
    counts = [sum(bool(bits & warning) for bits in warned) for warning in Unlearnt]
    assert min(counts) > 30


@needs_compiler
def test_a_rezeroed_file_has_its_interval_at_once(tmp_path):
    model = calibration(Polynomial(1), rezero=10.0)
    model = replace(model, zero=Zero(np.zeros(len(model.joints))))
    library = exported(tmp_path, model)
    assert library.functions.check() == 0
    assert assert_same_as_corrector(library, model, 400, 3) > 0.3
    library.functions.start()
    t, samples = random_stream(model, 400, 3)
    status, _, half_width, _ = library.run(t, samples, 3)
    assert np.isfinite(half_width[status == 0]).all()


@needs_compiler
def test_many_signals_are_checked_in_a_loop(tmp_path):
    names = [f"measured/s{i}" for i in range(40)]
    model = calibration(Polynomial(1), names, ("elbow",), rezero=0.0)
    model = replace(model, training_domain=replace(model.training_domain, distance=1e4))
    assert 0.3 < assert_same_as_corrector(exported(tmp_path, model), model, 300, 3) < 1.0


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


def test_vectors_hold_every_status_and_the_header_explains_them(tmp_path):
    export_c(calibration(Polynomial(3), HISTORY), tmp_path, prefix="m")
    text = (tmp_path / "m_vectors.h").read_text()
    seen = Status(0)
    statuses = [int(s) for s in re.findall(r"\}, (\d+), \{", text)]
    for status in statuses:
        seen |= Status(status)
    assert seen == ~(Status.WRONG_SIZE | Status.OTHER_THREAD)
    assert statuses.count(0) > 100
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


@pytest.mark.parametrize("precision", ["double", "float"])
@given(value=st.floats(width=32, allow_subnormal=False))
def test_numbers_are_exact(precision, value):
    text = table([value], precision).strip("{f}")
    got = float(text.replace("NAN", "nan").replace("INFINITY", "inf"))
    assert np.float32(got) == value or (math.isnan(got) and math.isnan(value))
    assert math.isnan(value) or math.copysign(1, got) == math.copysign(1, value)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_doubles_are_exact(value):
    assert float(table([value], "double")[1:-1]) == value


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
