"""Sensors that stand still: at their end, or for slack."""

from __future__ import annotations

import numpy as np
import pytest

from truejoint.recordings import DataCheck, Provenance, Recording, check_data


def _jaw(truth: np.ndarray, measured: np.ndarray) -> DataCheck:
    columns = {"t": np.arange(len(truth)) / 50, "measured/jaw": measured, "truth/jaw": truth}
    return check_data(Recording.from_columns(columns, "davinci_grasper"))


def _names(check: DataCheck) -> set[str]:
    return {finding.name for finding in check.findings if finding.level != "info"}


MEASURED = 0.5 * np.sin(0.7 * np.arange(3000) / 50) + 0.1 * np.sin(1.9 * np.arange(3000) / 50)


def test_a_saturated_sensor_is_found():
    check = _jaw(np.minimum(MEASURED, 0.4), MEASURED)
    (finding,) = [f for f in check.findings if f.name == "saturated"]
    assert finding.level == "fail"
    assert finding.where.startswith("truth/jaw")
    first, behind = finding.rows[0]
    assert (MEASURED[first:behind] >= 0.4).all()


@pytest.mark.parametrize(("setpoint", "load"), [(True, 0.0), (False, 0.2)])
def test_a_load_that_turns_a_standing_joint_is_no_saturation(setpoint, load):
    still = np.minimum.accumulate(np.append(np.linspace(0.5, 0.0, 600), np.zeros(600)))
    pushed = still - 0.2 * np.clip(np.arange(1200) / 200 - 4, 0.0, 1.0)
    columns = {"t": np.arange(1200) / 50, "measured/jaw": still, "truth/jaw": pushed}
    told = {"setpoint/jaw": still} if setpoint else {}

    def names(extra: dict[str, np.ndarray], load: float) -> set[str]:
        origin = Provenance("davinci_grasper", load=load)
        return _names(check_data(Recording.from_columns({**columns, **extra}, origin)))

    assert "saturated" not in names(told, load)
    assert "saturated" in names({}, 0.0), "the case shows nothing"
    assert "saturated" in names({"setpoint/jaw": pushed}, load), "a motor that was sent on"


def test_slack_is_no_saturation():
    """With play the joint stands at its end while the motor side turns back."""
    truth, place = np.empty(len(MEASURED)), 0.0
    for k, value in enumerate(MEASURED):
        place = min(max(place, value - 0.05), value + 0.05)
        truth[k] = place
    assert "saturated" not in _names(_jaw(truth, MEASURED))


def test_a_coarse_encoder_is_no_saturation():
    assert "saturated" not in _names(_jaw(np.round(MEASURED / 0.01) * 0.01, MEASURED))


@pytest.mark.parametrize(
    ("step", "suspected"), [(1e5, True), (100.0, True), (10.0, True), (0.01, False), (10.5, False)]
)
def test_stamps_in_milliseconds_are_suspected(step, suspected):
    columns = {"t": step * np.arange(500), "measured/jaw": MEASURED[:500]}
    columns["truth/jaw"] = MEASURED[:500]
    check = check_data(Recording.from_columns(columns, "davinci_grasper"))
    assert ("rate" in _names(check)) == suspected
