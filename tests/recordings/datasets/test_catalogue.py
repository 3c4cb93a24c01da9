import re

import pytest
from tests.recordings.refusals import refused

from truejoint.recordings import read_column_map
from truejoint.recordings.datasets import DATASETS, HeldOut, get_dataset
from truejoint.robots import get_robot

every_dataset = pytest.mark.parametrize("dataset", DATASETS.values(), ids=list(DATASETS))


@every_dataset
def test_an_entry_is_complete(dataset):
    for name in dataset.recordings:
        assert read_column_map(dataset.layout(name)["map"]).robot == dataset.robot
    assert get_robot(dataset.robot).name == dataset.robot
    assert re.fullmatch(r"[\w.-]+/[\w.-]+", dataset.repository)
    assert re.fullmatch(r"[0-9a-f]{40}", dataset.commit)
    assert dataset.citation
    # Without truth there is nothing to fit or to judge.
    assert bool(dataset.features) == bool(dataset.splits) == (dataset.name != "raven2_motor_side")
    files = [file for part in dataset.recordings.values() for file in part]
    assert len({file.name for file in files}) == len(files) > 1
    for file in files:
        assert re.fullmatch(r"[0-9a-f]{64}", file.sha256)
        assert file.size > 1000


@every_dataset
def test_splits_hold_something_out_and_leave_something(dataset):
    for split in dataset.splits:
        chosen = dataset.match(split.files)
        if split.test:
            held_out = dataset.match(split.test)
            assert set(held_out) < set(chosen)
            assert held_out == tuple(name for name in chosen if split.holds_out(name))
        else:
            assert 0 < split.test_fraction < 1
            assert not any(map(split.holds_out, chosen))


def test_the_grasper_is_held_out_by_frequency_and_load():
    dataset = get_dataset("davinci_grasper_umn")
    by_frequency = dataset.match(dataset.split("frequency").test)
    assert [name[-2:] for name in by_frequency] == [f"3{load}" for load in range(10)]
    by_load = dataset.match(dataset.split("load").test)
    assert [name[-2:] for name in by_load] == [f"{f}{load}" for f in range(5) for load in (3, 7)]


def test_a_file_may_come_from_another_repository():
    dataset = get_dataset("raven2_motor_side")
    first, second = (files[0] for files in dataset.recordings.values())
    assert dataset.url(first).endswith(
        f"CSLDepend/raven2_sim/{dataset.commit}/Li_DYN/Matlab/test_joint123.mat"
    )
    assert dataset.origin(second)[0] == "HaonanPeng/RAVEN_ILC"
    assert dataset.url(second).endswith("/recorderFiles/ravenJoint_pose_recorder.txt")


def test_an_address_is_quoted():
    dataset = get_dataset("kuka_kr300_dual_encoder")
    url = dataset.url(dataset.recordings["FF_A"][0])
    assert url == (
        "https://raw.githubusercontent.com/JonasWeigand/Robot_Identification/"
        "9e403c07d9dadbb391a9f3921e8d219f714636a8/data/recorded_trajectories/"
        "2020-10-21%2010s%20FF%20A%2008ms/data.mat"
    )


def test_names_that_are_not_there_are_answered_with_those_that_are():
    refused("no data set called 'x'; known: davinci_grasper", get_dataset, "x")
    dataset = get_dataset("bros_dual_encoder")
    refused(r"no recording fits 'part9'; there are part1, part2", dataset.match, "part9")
    refused("no split called 'x'; known: part", dataset.split, "x")
    assert dataset.split() == dataset.splits[0]


@pytest.mark.parametrize(
    "options", [{}, {"test": "a", "test_fraction": 0.3}, {"test_fraction": 1.0}]
)
def test_a_split_is_by_recording_or_by_time(options):
    refused("either test or a test_fraction", HeldOut, "s", "*", **options)
