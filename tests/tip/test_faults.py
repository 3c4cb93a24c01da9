"""Points that fit only if something is wrong with them are refused, and it is named."""

import numpy as np
import pytest
from tests.drawn_arm import FAULTS, NOISE, DrawnArm, block_session, way

from truejoint.errors import CalibrationError
from truejoint.tip import (
    Touches,
    calibrate_by_touch,
    find_block,
    read_pose,
    write_pose,
    zero_by_touch,
)

TAKEN = (
    ("block", "1 % larger, unmeasured"), ("tracker", "1 % larger"),
    ("tracker", "marker 3 mm off, wrist moves"),
)  # fmt: skip
"""No touch tells a block's size from the insertion's; what it may cost is told. A marker's place is
fitted."""
SELDOM = [
    ("tracker", "marker 10 mm off, wrist moves"),
    *(("block", name) for name in (
        "1 % larger, measured wrongly", "moved by 0.5 mm amid", "moved by 2 mm amid",
        "moved by 5 mm amid", "mirrored in y", "mirrored in z", "numbered along y",
    )),
]  # fmt: skip
"""The benchmark alone tries these."""


@pytest.mark.parametrize("fault", [each for each in FAULTS if each not in SELDOM])
def test_a_fault_is_named(fault):
    make, word = FAULTS[fault]
    session = make(DrawnArm(1))
    given = session.recording, session.touches, session.block
    if fault in TAKEN:
        model, report = calibrate_by_touch(*given, touch_sd=NOISE[fault[0]])
        assert any(word in text for text in report.not_seen)
        assert session.tip_error(model, near=True) < 3.0 * report.tip.rms
        marker = way(1, float(fault[1].split()[1])) if word == "off the tip" else np.zeros(3)
        assert np.linalg.norm(model.metadata["touch"]["marker"] - marker) < 5e-4
        return
    with pytest.raises(CalibrationError, match=word) as told:
        calibrate_by_touch(*given, touch_sd=NOISE[fault[0]])
    assert "\n" not in str(told.value)
    if fault[0] == "tracker":
        assert "shots.csv" in str(told.value)
        assert not any(strange in str(told.value) for strange in ("block", "plate", "dimple"))


def test_a_fault_that_is_likelier_but_not_far_is_said():
    session = FAULTS["block", "moved by 0.5 mm amid"][0](DrawnArm(0))
    _, report = calibrate_by_touch(session.recording, session.touches, session.block)
    said = "the points fit better when the block moves by 0.4"
    assert any(text.startswith(said) for text in report.not_seen)


def test_touches_that_a_moved_block_bends_widen_the_deviations():
    arm, homing = DrawnArm(8), np.random.default_rng([8, 31]).standard_normal(3)
    homing *= [np.deg2rad(0.3), np.deg2rad(0.5), 4e-4]
    day = block_session(arm, 30, 0)
    model = arm.model()
    pose, _ = find_block(model, day.recording, day.touches, day.block)
    few = block_session(DrawnArm(8, moved=way(8, 3.5), homing=homing), 6, 0, day=1)
    zero, fit = zero_by_touch(model, few.recording, few.touches, pose)
    assert fit.misfit > 2.0 * fit.freedom
    assert (np.abs(zero.offset - homing) < 3.0 * zero.deviation).all()


def test_a_slope_that_no_arm_has_is_refused():
    arm = DrawnArm(3)
    arm.scale = np.array([1.0, 1.6, 1.0])
    session = block_session(arm)
    with pytest.raises(CalibrationError, match=r"slope of elbow would be 1\.\d+, where 0\.\d+ to"):
        calibrate_by_touch(session.recording, session.touches, session.block)


@pytest.mark.parametrize("references", [0, 6])
def test_a_bolted_block_that_moves_is_refused_or_widens_the_deviations(references, tmp_path):
    arm = DrawnArm(0)
    model, day = arm.model(), block_session(arm, 30, 0, references=references)
    pose, _ = find_block(model, day.recording, day.touches, day.block)
    assert set(pose.block.references) == set(day.block.references if references else ())
    write_pose(pose, tmp_path / "pose.toml")
    pose = read_pose(tmp_path / "pose.toml")
    ratios, refused = [], {}
    for millimetres in (0.0, 0.5, 2.0):
        today = DrawnArm(0, moved=way(0, millimetres), homing=np.array([2e-3, 4e-3, 2e-4]))
        few = block_session(today, 6, 0, references=references, day=1)
        try:
            zero, _ = zero_by_touch(model, few.recording, few.touches, pose)
        except CalibrationError as error:
            refused[millimetres] = str(error)
            continue
        ratios.append((np.abs(zero.offset - today.homing) / zero.deviation).max())
        assert zero.details["unnoticed_move"] > (2e-4 if references else 5e-4)
    assert max(ratios) < 3.0
    assert all("moved by" in told or "moves by" in told for told in refused.values())
    assert 0.0 not in refused
    assert 2.0 in refused or not references


def test_a_reference_is_no_dimple():
    with pytest.raises(CalibrationError, match="has no dimple 'R9'"):
        block_session(DrawnArm(0), 6, 0).block.at(("R9",))
    touches = Touches((1.0, 2.0), ("3", "R0"))
    assert touches.among({"R0"}).dimple == ("R0",)
    assert touches.among({"R0"}, are_in=False).t == (1.0,)
