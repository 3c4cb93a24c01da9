"""The page of a calibration by touch says what was rejected and what was not seen."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tests.tip.test_touch_calibration import session

from truejoint.errors import RecordingError
from truejoint.evaluation.report.page import write_touch_report
from truejoint.tip import calibrate_by_touch


def test_the_page_says_what_touches_are_worth(tmp_path):
    recording, touches, block, _ = session(30, 2)
    points = dict(block.points)
    points["4"] = points["4"] + [1.5e-3, 1e-3, -1e-3]
    model, report = calibrate_by_touch(recording, touches, replace(block, points=points))
    path = write_touch_report(model, report, tmp_path / "touches.html")
    page = path.read_text()
    assert "30 touches, 1 of them rejected" in page
    assert "zero of shoulder: not seen, assumed within" in page
    rows = re.findall(r'<th scope="row">(\d+)</th><td>([^<]*)</td>', page)
    assert rows[0] == ("4", "rejected: badly seated, or another number?")
    assert {name for name, _ in rows} == set(block.points)
    stated = float(re.search(r"before ([\d.]+) mm", page)[1])
    kept = ~report.fit.left_out
    before = np.sqrt((report.before[kept] ** 2).sum(axis=1).mean())
    assert stated == pytest.approx(1e3 * before, abs=1e-3)
    shown = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r'(?:src|href)="(?!#|data:)', shown)
    with pytest.raises(RecordingError, match="exists already"):
        write_touch_report(model, report, path)
