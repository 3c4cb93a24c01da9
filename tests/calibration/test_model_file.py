"""The model file: round trip to the bit, and nothing but one line on anything else."""

import copy
import json
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import RandomState

from truejoint.calibration import (
    Calibration,
    calibrate,
    model_file,
    read_calibration,
    with_interval,
    write_calibration,
)
from truejoint.calibration.model_file import FORMAT_VERSION, decode, encode, from_bytes, to_bytes
from truejoint.errors import ModelFileError
from truejoint.estimators import NeuralNetwork

FEATURES = (
    "measured/elbow",
    "effort/elbow",
    "lag(measured/elbow, 2)",
    "play(measured/elbow, 0.02)",
)


@pytest.fixture(scope="module")
def calibration(recording):
    network = NeuralNetwork(hidden_layer_sizes=(5, 4), epochs=2)
    return calibrate(recording, network, features=FEATURES, joints=["elbow", "insertion"])


@pytest.fixture(scope="module")
def saved(calibration) -> bytes:
    return to_bytes(*encode(calibration))


def same(one, other, recording) -> bool:
    """Whether two calibrations are one: same file, and same bits for every estimator in it."""
    corrected = [(c.correct(recording).tobytes(), {n: b.correct(recording).tobytes()
                  for n, b in c.baselines.items()}) for c in (one, other)]  # fmt: skip
    return corrected[0] == corrected[1] and to_bytes(*encode(one)) == to_bytes(*encode(other))


@pytest.mark.parametrize(
    ("estimator", "target"),
    [
        ("linear", "error"),
        (NeuralNetwork(hidden_layer_sizes=[3], epochs=1, random_state=RandomState(1)), "position"),
    ],
    ids=["a preset", "parameters that are no plain values"],
)
def test_round_trip_is_bit_for_bit(tmp_path, recording, build, estimator, target):
    made = calibrate(recording, estimator, features=FEATURES, target=target)
    made = made.with_metadata(held_out={"elbow": 0.1}, command="truejoint calibrate é.parquet")
    path = tmp_path / "model.safetensors"
    write_calibration(made, path)
    read = read_calibration(path)
    assert same(made, read, build(100, 4))
    assert read.metadata == made.metadata
    assert (read.robot, read.arm, read.joints) == (made.robot, made.arm, made.joints)
    assert (read.target, read.units, read.gap_limit) == (made.target, made.units, made.gap_limit)
    np.testing.assert_array_equal(read.lower, made.lower)
    np.testing.assert_array_equal(read.upper, made.upper)


def test_nothing_is_overwritten_unasked(tmp_path, calibration):
    path = tmp_path / "model.safetensors"
    path.write_bytes(b"precious")
    with pytest.raises(ModelFileError, match=r"model\.safetensors: exists already"):
        write_calibration(calibration, path)
    assert path.read_bytes() == b"precious"
    write_calibration(calibration, path, overwrite=True)
    assert read_calibration(path).joints == calibration.joints
    assert [p.name for p in tmp_path.iterdir()] == ["model.safetensors"]


def test_places_that_cannot_be_used_are_named(tmp_path, calibration):
    with pytest.raises(ModelFileError, match=r"nowhere does not exist"):
        write_calibration(calibration, tmp_path / "nowhere" / "model.safetensors")
    with pytest.raises(ModelFileError, match=r"absent: cannot be read \(No such file"):
        read_calibration(tmp_path / "absent")
    with pytest.raises(ModelFileError, match="cannot be read"):
        read_calibration(tmp_path)


def test_model_that_could_not_be_read_back_is_not_written(tmp_path, calibration):
    path = tmp_path / "model.safetensors"
    path.write_bytes(b"precious")
    bulky = calibration.with_metadata(notes="x" * 2**21)
    with pytest.raises(ModelFileError, match="is not written, it could not be read back"):
        write_calibration(bulky, path, overwrite=True)
    assert path.read_bytes() == b"precious"


def load_bytes(tmp_path, data: bytes):
    path = tmp_path / "model.safetensors"
    path.write_bytes(data)
    return read_calibration(path)


def refused(tmp_path, data: bytes, said: str) -> None:
    with pytest.raises(ModelFileError, match=said) as caught:
        load_bytes(tmp_path, data)
    assert "\n" not in str(caught.value)
    assert "model.safetensors" in str(caught.value)


def test_damaged_files_are_refused_in_one_line(tmp_path, saved, monkeypatch):
    refused(tmp_path, b"", "cut short")
    refused(tmp_path, b"PAR1 and so on", "is a Parquet file, as recordings are")
    refused(tmp_path, saved[:5], "cut short")
    refused(tmp_path, saved[:200], "cut short")
    refused(tmp_path, saved[:-8], "its arrays cannot be read")
    refused(tmp_path, saved + b"\0", "its arrays cannot be read")
    refused(tmp_path, saved[:-3] + b"\x01" + saved[-2:], "does not match its hash")
    refused(tmp_path, saved.replace(b"raven2", b"raven3"), "does not match its hash")
    refused(tmp_path, b"PK12" + saved, "not a safetensors file")
    plain = safetensors.numpy.save({"a": np.zeros(3)})
    refused(tmp_path, plain, "without truejoint's part")
    monkeypatch.setattr(model_file, "MAX_FILE_BYTES", 1000)
    refused(tmp_path, saved, "holds more than 1000 bytes")


def with_header(header: Any, data: bytes = b"") -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


@pytest.mark.parametrize(
    "header",
    [
        b"", b"{", b"[]", b"null", b"\xff\xfe", b"[" * 100_000, b'{"a": NaN}', b'{"a":1,"a":2}',
        b'{"a":' + b"9" * 5000 + b"}", {"__metadata__": 3}, {"__metadata__": {"truejoint": 3}},
        {"__metadata__": {"truejoint": "[" * 50_000}}, {"__metadata__": {"truejoint": "[]"}},
        {"__metadata__": {"truejoint": '{"format": true}'}},
        {"__metadata__": {"truejoint": '{"format": 1e999}'}},
        {"__metadata__": {"truejoint": '{"format": 8, "a": 1e999}'}},
        {"__metadata__": {"truejoint": '{"format": 8, "a": "\\ud800"}'}},
    ],
    ids=lambda header: str(header)[:40],
)  # fmt: skip
def test_hostile_headers_are_refused(tmp_path, header):
    refused(tmp_path, with_header(header), "model.safetensors: ")


@pytest.mark.parametrize(
    "entry",
    [
        3, {}, {"dtype": "F64", "shape": [2], "data_offsets": [0, 8]},
        {"dtype": "F32", "shape": [2], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [2**40], "data_offsets": [0, 2**43]},
        {"dtype": "F64", "shape": [-1], "data_offsets": [8, 0]},
        {"dtype": "F64", "shape": [True], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": "1", "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [1], "data_offsets": [0, 8, 16]},
        {"dtype": "F64", "shape": [1], "data_offsets": [8, 16]},
        {"dtype": "F64", "shape": [1, 1, 1], "data_offsets": [0, 8]},
        {"dtype": "F64", "shape": [1], "data_offsets": [0.0, 8.0]},
    ],
    ids=str,
)  # fmt: skip
def test_headers_that_lie_about_tensors_are_refused(tmp_path, entry):
    header = {"__metadata__": {"truejoint": '{"format": 8}'}, "a": entry}
    refused(tmp_path, with_header(header, bytes(16)), r"tensor|its arrays cannot be read")


@pytest.mark.parametrize(
    ("version", "said"),
    [
        (FORMAT_VERSION + 1, rf"version {FORMAT_VERSION + 1} is newer .* update"),
        (FORMAT_VERSION - 1, rf"version {FORMAT_VERSION - 1} is not .* calibrate again"),
    ],
)
def test_another_format_is_told_from_damage(tmp_path, saved, version, said):
    length = int.from_bytes(saved[:8], "little")
    header = json.loads(saved[8 : 8 + length])
    inner = json.loads(header["__metadata__"]["truejoint"])
    header["__metadata__"]["truejoint"] = json.dumps({**inner, "format": version, "novelty": 1})
    refused(tmp_path, with_header(header, saved[8 + length :]), said)


@given(st.data())
def test_mutated_bytes_give_an_error_or_the_same_model(
    tmp_path_factory, calibration, saved, build, data
):
    mutated = bytearray(saved)
    length = int.from_bytes(saved[:8], "little") + 8
    for _ in range(data.draw(st.integers(1, 3))):
        # Half of the blows hit the header, which is a small part of the file.
        end = data.draw(st.sampled_from([length, len(mutated)]))
        at = data.draw(st.integers(0, min(end, len(mutated)) - 1))
        blow = data.draw(st.sampled_from(["set", "cut", "insert", "delete", "copy"]))
        if blow == "set":
            mutated[at] = data.draw(st.integers(0, 255))
        elif blow == "cut":
            del mutated[max(at, 1) :]
        elif blow == "insert":
            mutated[at:at] = data.draw(st.binary(min_size=1, max_size=9))
        elif blow == "delete":
            del mutated[at : at + data.draw(st.integers(1, 9))]
        else:
            mutated[at : at + 8] = mutated[:8]
        if not mutated:
            return
    try:
        read = load_bytes(tmp_path_factory.getbasetemp(), bytes(mutated))
    except ModelFileError as error:
        assert "\n" not in str(error)  # noqa: PT017  # other exceptions must pass through
        return
    assert same(calibration, read, build(30, 6))


@pytest.mark.parametrize(
    ("key", "lie"),
    [("units", ["rad"]), ("units", "rad"), ("units", {"measured/elbow": ""}),
     ("units", {"measured/elbow": "x" * 41}), ("units", {"measured/elbow": "\n"}),
     ("units", {"measured/elbow": 1}), ("units", {"measured/elbow": "rad"}), ("target", "speed"),
     ("target", None), ("gap_limit", 0.0), ("gap_limit", -1.0), ("gap_limit", "1"),
     ("origin/sessions", 5), ("origin/sessions", [1]), ("origin/sessions", [{}]),
     ("origin/sessions", [{"sha256": "", "first": 0.0, "last": "late"}]),
     ("origin/sessions", [{"sha256": "", "first": 0.0, "last": 1.0, "load": "heavy"}]),
     ("origin/interval_sessions", ["x"]), ("origin/baseline_notes", 5), ("origin/homing_ids", "h1"),
     ("origin/accepted", [1]), ("origin/estimator", 5), ("origin/sample_dt", -1.0),
     ("origin/sample_dt", "30"), ("origin/zeros", {"per": "day", "names": [], "offsets": []})],
)  # fmt: skip
def test_a_lie_is_refused_by_its_field(tmp_path, saved, key, lie):
    description, arrays = from_bytes(saved)
    *part, field = key.split("/")
    (description["origin"] if part else description)[field] = lie
    refused(tmp_path, to_bytes(description, arrays), key.replace("/", ".*"))


def test_no_name_of_a_column_becomes_source(tmp_path, saved):
    description, arrays = from_bytes(saved)
    hostile = {"motor/a }; int main(void) { return 1; } enum { b": "rad"}
    refused(tmp_path, to_bytes({**description, "redundant": hostile}, arrays), "is called as none")


def test_a_model_that_counts_samples_states_its_time_step(tmp_path, saved):
    description, arrays = from_bytes(saved)
    description["origin"]["sample_dt"] = 0.0
    refused(tmp_path, to_bytes(description, arrays), "the time step is not stated")


@pytest.fixture(scope="module")
def complete(recording, build) -> Calibration:
    """A calibration with all parts that a file may hold besides its models."""
    features = ("measured/shoulder", "measured/elbow", "measured/insertion", "effort/elbow")
    motions = [build(200, seed, homing_id=f"h{seed}") for seed in range(10, 32)]
    return with_interval(calibrate(recording, "linear", features=features), motions)


def test_every_part_survives_its_file_and_may_be_missing(tmp_path, complete, recording):
    write_calibration(complete, tmp_path / "model.safetensors")
    assert same(read_calibration(tmp_path / "model.safetensors"), complete, recording)
    bare = replace(complete, training_domain=None, effort_baseline=None, interval=None)
    read = load_bytes(tmp_path, to_bytes(*encode(bare)))
    assert read.training_domain is read.effort_baseline is read.interval is None
    np.testing.assert_array_equal(read.correct(recording), complete.correct(recording))


@pytest.mark.parametrize(
    ("path", "change"),
    [
        ("training_domain/dt", lambda a: a * 0),
        ("training_domain/hold", lambda a: a - 1e9),
        ("training_domain/distance", lambda a: a * np.nan),
        ("training_domain/signal_step", lambda a: -1.0 - a),
        ("training_domain/signal_lower", lambda a: a + 1e9),
        ("training_domain/error_upper", lambda a: a - 1e9),
        ("training_domain/stride", lambda a: a * 0),
        ("training_domain/pace_lower", lambda a: a + 1e9),
        ("training_domain/swings", lambda a: a[:, 1:]),
        ("training_domain/whitening", lambda a: a[1:]),
        ("training_domain/surprise", lambda a: a),
        ("effort_baseline/scale", lambda a: a * 0),
        ("effort_baseline/coef", lambda a: a[:, 1:]),
        ("effort_baseline/coef", lambda a: a * np.nan),
        ("effort_baseline/monitored", lambda a: a - 2),
        ("effort_baseline/upper", lambda a: a - 10),
        ("effort_baseline/residual", lambda a: -a),
        ("effort_baseline/extra", lambda a: a),
        ("interval/levels", lambda a: a[::-1]),
        ("interval/levels", lambda a: a + 0.5),
        ("interval/levels", lambda a: a[:0]),
        ("interval/levels", lambda a: np.append(0.0, a[1:])),
        ("interval/half_widths", lambda a: -a),
        ("interval/half_widths", lambda a: a * np.nan),
        ("interval/half_widths", lambda a: a[:, :2]),
        ("interval/half_widths", lambda a: a[::-1]),
        ("interval/trajectories", lambda a: a * 0 + 12),  # too few for the 95 % that it states
        ("interval/growth", lambda a: a - 100),
        ("interval/rezero", lambda a: np.append(a, a)),
        ("interval/extra", lambda a: a),
    ],
)
def test_an_edited_part_is_refused_by_its_name(complete, path, change):
    description, arrays = encode(complete)
    arrays[path] = change(arrays.get(path, np.zeros(1)))
    with pytest.raises(ModelFileError, match=path.partition("/")[0].replace("_", " ")):
        decode(description, arrays)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.text(max_size=8)
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)  # fmt: skip


def paths(value: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a JSON value but its root."""
    inner: Any = ()
    if isinstance(value, dict):
        inner = value.items()
    elif isinstance(value, list):
        inner = enumerate(value)
    return [here] * bool(here) + [p for key, v in inner for p in paths(v, (*here, key))]


@given(st.data())
def test_signed_lies_give_an_error_or_a_working_model(tmp_path_factory, saved, recording, data):
    """A forger who also makes the hash right: every field is checked on its own."""
    description, arrays = from_bytes(saved)
    description, arrays = copy.deepcopy(description), dict(arrays)
    places = [p for p in paths(description) if p[0] != "metadata"]
    if data.draw(st.booleans()):
        *way, last = data.draw(st.sampled_from(places))
        target: Any = description
        for key in way:
            target = target[key]
        if data.draw(st.booleans()):
            target[last] = data.draw(JSON)
        else:
            del target[last]
    else:
        name = data.draw(st.sampled_from(sorted(arrays)))
        shape = data.draw(st.lists(st.integers(0, 6), max_size=2))
        arrays[name] = np.full(shape, data.draw(st.floats()))
    try:
        forged = to_bytes(description, arrays)
        read = load_bytes(tmp_path_factory.getbasetemp(), forged)
    except ModelFileError as error:
        assert "\n" not in str(error)  # noqa: PT017  # other exceptions must pass through
        return
    assert len(read.joints) == 2
    if (read.robot, read.arm) == ("raven2", "left") and read.joints == ("elbow", "insertion"):
        assert read.model.evaluate(np.zeros((2, len(read.feature_set)))).shape == (2, 2)
