import json
import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.recordings.refusals import refused

from truejoint.recordings import Provenance, Recording, Stream
from truejoint.recordings.table.recording import default_unit, runs
from truejoint.robots import get_robot

BROS = Provenance(robot="bros", source="bench.csv")


def columns(**changed: object) -> dict[str, object]:
    base: dict[str, object] = {
        "t": [0.0, 0.1, 0.2],
        "measured/joint1": [1.0, 2.0, 3.0],
        "truth/joint1": [1.5, np.nan, 3.5],
    }
    base |= {name.replace("__", "/"): value for name, value in changed.items()}
    return base


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"t": [0.0, 0.1, 0.1]}, "time stamp of row 2 goes back or repeats"),
        ({"t": [0.0, 0.2, 0.1]}, r"row 2 goes back or repeats \(0.100000 s after 0.200000 s\)"),
        ({"t": [0.0, np.nan, 0.1]}, "column 't' row 1 is nan"),
        ({"measured__joint1": [1.0, np.nan, 2.0]}, "'measured/joint1' row 1 is nan; only truth"),
        ({"measured__joint1": [1.0, np.inf, 2.0]}, "'measured/joint1' row 1 is inf"),
        ({"truth__joint1": [1.0, np.inf, 2.0]}, "'truth/joint1' row 1 is inf"),
        ({"measured__joint1": [1.0, 2.0]}, r"'measured/joint1' has shape \(2,\); want \(3,\)"),
    ],
)
def test_a_rule_that_is_broken_is_named(changed, message):
    text = refused(message, Recording.from_columns, columns(**changed), BROS)
    assert text.startswith("bench.csv: ")


def test_a_recording_needs_time_and_rows():
    refused("no column 't'", Recording.from_columns, {"measured/joint1": [1.0, 2.0]}, BROS)
    refused(
        "1 rows; a recording needs at least 2",
        Recording.from_columns,
        {"t": [0.0], "measured/joint1": [1.0]},
        BROS,
    )
    refused(
        "no column 'truth/elbow'; it has t, measured/joint1",
        Recording.from_columns(columns(), BROS).column,
        "truth/elbow",
    )
    refused("this is a NoneType, not a Provenance; give", Recording.from_columns, columns(), None)  # type: ignore[arg-type]


def test_error_is_what_is_to_be_added(recording):
    error = recording.error(["joint1"])
    corrected = recording.columns("measured", ["joint1"]) + error
    assert np.allclose(corrected, recording.columns("truth", ["joint1"]), equal_nan=True)
    assert np.isnan(error[20:30]).all()
    assert recording.columns("truth", []).shape == (len(recording), 0)
    known = recording.with_truth(["joint1"])
    assert np.array_equal(known.t, np.delete(recording.t, np.arange(20, 30)))


@pytest.mark.parametrize(
    ("column", "unit"),
    [
        ("measured/insertion", "m"),
        ("velocity/insertion", "m/s"),
        ("effort/insertion", "Nm"),
        ("truth_effort/insertion", "N"),
        ("measured/unused", "rad"),
        ("truth/elbow", "rad"),
        ("motor/insertion", "rad"),
        ("current/elbow", "A"),
        ("vision/elbow", "1"),
    ],
)
def test_units_of_raven_columns(column, unit):
    assert default_unit(column, get_robot("raven2")) == unit
    assert default_unit("effort/outer_insertion", get_robot("dvrk_psm")) == "N"


@pytest.mark.parametrize(
    "values",
    [
        {"arm": "left"},
        {"robot": "bros", "colour": "red"},
        {"robot": 3},
        {"robot": "bros", "load": "heavy"},
        {"robot": "bros", "rates": [1.0]},
        {"robot": "bros", "dropped": {"x": "many"}},
        {"robot": "bros", "source": None},
    ],
)
def test_provenance_of_the_wrong_shape_is_refused(values):
    refused("provenance", Provenance.from_dict, values)


@given(st.lists(st.booleans(), max_size=60))
def test_runs_hold_what_is_true_and_nothing_else(same):
    found = runs(np.array(same, dtype=bool))
    assert [k for first, end in found for k in range(first, end)] == np.flatnonzero(same).tolist()
    assert all(end < first for (_, end), (first, _) in pairwise(found))


def test_arrays_are_copied_unless_they_are_handed_over():
    columns = {"t": np.arange(3.0), "measured/jaw": np.zeros(3)}
    copied = Recording.from_columns(columns, "davinci_grasper")
    kept = Recording.from_columns(columns, "davinci_grasper", copy=False)
    assert not np.shares_memory(copied.column("measured/jaw"), columns["measured/jaw"])
    assert np.shares_memory(kept.column("measured/jaw"), columns["measured/jaw"])


@pytest.mark.parametrize(
    "stated",
    [{"load": "500 g"}, {"load": math.inf}, {"session": 5}, {"rates": None}, {"dropped": [1]}],
)
def test_provenance_that_no_file_could_keep_is_refused_when_it_is_made(stated):
    refused(f"provenance: '{next(iter(stated))}' is", Provenance, "bros", **stated)


def test_numbers_of_numpy_are_kept_as_plain_ones():
    rates = {"state": Fraction(61, 2)}
    made = Provenance("bros", load=np.float32(0.5), rates=rates, dropped={"x": np.int64(3)})
    kept = json.loads(json.dumps(made.to_dict()))
    assert (kept["rates"], kept["dropped"]) == ({"state": 30.5}, {"x": 3})
    assert made.load == 0.5


def test_a_unit_that_is_not_of_si_is_refused_with_what_to_do():
    refused(
        r"'deg', not SI; multiply it by 0.01745\d+ and state",
        Recording.from_columns,
        columns(),
        BROS,
        {"measured/joint1": "deg"},
    )
    refused(
        "unit of 'measured/joint1' is 5, not SI",
        Recording.from_columns,
        columns(),
        BROS,
        {"measured/joint1": 5},
    )  # type: ignore[dict-item]


@pytest.mark.parametrize("count", [10**400, -(10**400)])
def test_a_whole_number_beyond_any_float_is_refused(count):
    refused("provenance: 'load' is", Provenance, "bros", load=count)
    refused("too large to convert to float", Recording.from_columns, {"t": [0, count]}, "bros")
    refused(
        r"'truth/joint1'.* too large .*; give numbers", Stream, [0.0], {"truth/joint1": [count]}
    )  # type: ignore[arg-type]


@pytest.mark.parametrize("selection", [[True, False], np.array([10**6]), "a"])
def test_rows_that_a_recording_has_not_are_refused(recording, selection):
    refused("give a slice, numbers of rows, or a mask of all", recording.rows, selection)
    refused("1 rows; a recording needs at least 2", recording.rows, 5)  # type: ignore[arg-type]


def test_a_robot_goes_where_its_name_goes(recording):
    table = recording.table[["t", "measured/joint1"]]
    made = Recording.from_columns(table, recording.robot)
    assert made.robot is recording.robot
    assert made.provenance.robot == recording.robot.name


@pytest.mark.parametrize("kind", ["complex", "datetime64[ns]", "timedelta64[s]"])
def test_a_column_of_dates_or_complex_numbers_is_refused(kind):
    table = {"t": np.arange(3).astype(kind), "measured/joint1": np.zeros(3)}
    refused("is no column of numbers, such as seconds", Recording.from_columns, table, "bros")
