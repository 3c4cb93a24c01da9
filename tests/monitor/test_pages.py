"""Tests of truejoint.monitor.pages and page: as a browser would see it, and in one."""

import json
import os
import signal
import socket
import sys
import urllib.error
import urllib.request
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from truejoint.errors import CalibrationError, CommandRefused, TruejointError
from truejoint.monitor import ArmPage, RecordingPage, pages
from truejoint.monitor.page import PLOT_EVERY
from truejoint.monitor.process import ArmView, PageProcess, _plain, _samples
from truejoint.monitor.samples import Condition, Samples
from truejoint.recordings import Recording

LOOP = pages._Pictures._loop


@pytest.fixture
def by_hand(monkeypatch):
    """Pictures are made when a test asks for them, those of an arm in this process."""
    monkeypatch.setattr(pages, "PageProcess", Drawn)
    monkeypatch.setattr(pages._Pictures, "_loop", lambda page: None)


class Drawn(ArmView):
    """Draws all that it is told at once."""

    def show(self, row, condition):
        super().show(row, condition)
        self.draw()


@pytest.fixture
def page(by_hand, lagging_arm):
    with ArmPage(lagging_arm, port=0) as page:
        yield page


def _move(arm):
    arm.move_jp(arm.robot.home + 0.05 * np.eye(7)[0]).wait()


def test_numbers_follow_the_arm(page, lagging_arm):
    for way in (0.05, -0.03):
        lagging_arm.move_jp(lagging_arm.robot.home + way * np.eye(7)[0]).wait()
        page._frame()
        now = lagging_arm.measured_js()
        assert "ENABLED" in page._page._status.content
        # The row that is shown is the latest that a reading of the encoders follows.
        shown = page._page.samples
        assert now.t - 0.01 <= shown.t[-1] <= now.t
        assert f"{np.degrees(shown.reported[-1, 0]):.2f}" in page._page._table.content
        assert f'data-t="{shown.t[-1]:.4f}"' in page._page._status.content
    tool = lagging_arm.robot.kinematics.forward(page._page.samples.reported[-1])[:3, 3]
    turned = lagging_arm.robot.kinematics.crtk_from_base[:3, :3] @ tool
    assert page._page._bodies["reported"].tool == pytest.approx(turned, abs=1e-9)
    assert sorted(page._page._bodies) == ["reported", "truth"]
    for _ in range(3):
        page._frame()
    assert len(page._page.samples) == 2  # nothing new was reported
    lost = replace(shown, reported=np.full_like(shown.reported, np.nan))
    page._page.show(lost, Condition("ENABLED"))
    assert not any(body._tubes.visible for body in page._page._bodies.values())


def test_the_buttons_pause_and_resume_the_arm(page, lagging_arm):
    _move(lagging_arm)
    page._command("pause")
    assert lagging_arm.operating_state().state == "PAUSED"
    page._frame()
    assert page._page.resume.visible
    page._command("resume")
    page._frame()
    assert lagging_arm.operating_state().state == "ENABLED"
    assert not page._page.resume.visible
    lagging_arm.disable()
    page._command("resume")  # refused: told to who looks, never raised
    assert lagging_arm.operating_state().state == "DISABLED"


def test_an_arm_that_stops_reporting_turns_grey(page, lagging_arm, lagging_backend):
    _move(lagging_arm)
    page._frame()
    tubes = page._page._bodies["reported"]._tubes
    coloured, table = tubes.batched_colors.tolist(), page._page._table.content
    lagging_backend.time += 4.0
    page._frame()
    assert "no message for 4 s" in page._page._status.content
    assert "the newest state message is 4 s old" in page._page._status.content
    assert 'class="stale"' in page._page._table.content
    assert page._page._table.content == table.replace('id="joints"', 'id="joints" class="stale"')
    assert tubes.batched_colors.tolist() != coloured
    _move(lagging_arm)
    page._frame()
    assert tubes.batched_colors.tolist() == coloured


def test_a_model_that_the_arm_cannot_serve_is_named_and_the_arm_still_shown(
    page, lagging_arm, monkeypatch
):
    def refuse(*_, **__):
        raise CalibrationError("does not report x")

    monkeypatch.setattr(page._live, "row", refuse)
    _move(lagging_arm)
    page._frame()
    assert "does not report x" in page._page._status.content
    _move(lagging_arm)
    page._frame()
    assert "does not report x" in page._page._status.content
    assert "shoulder" in page._page._table.content


def test_an_arm_that_once_gives_no_answer_is_corrected_on(page, lagging_arm, monkeypatch):
    _move(lagging_arm)
    live, answers = page._live, [lagging_arm.operating_state()]  # of two questions a picture
    with monkeypatch.context() as patch:
        patch.setattr(lagging_arm, "operating_state", answers.pop)
        page._frame()
    assert not page._refusal
    assert page._live is live
    assert len(page._page.samples) == 1


def test_a_robot_without_kinematics_has_plots_alone(by_hand, jaw_recording, jaw_model):
    with RecordingPage(jaw_recording, jaw_model, port=0) as page:
        page._t = 1.0
        page._frame()
        assert page._page._bodies == {}
        titles = [shape[0] for shape in page._page._plots]
        assert titles == [
            "whole recording: corrected - true, jaw [deg]", "jaw [deg]", "correction of jaw [deg]",
            "corrected - true, jaw [deg]", "effort of jaw [Nm]", "between state messages [ms]",
        ]  # fmt: skip
        whole, position = list(page._page._plots.values())[:2]
        assert whole.data[0][-1] == pytest.approx(3.99)
        is_shown = np.isfinite(whole.data[2])
        assert whole.data[0][is_shown][-1] == pytest.approx(1.0, abs=0.01)
        assert position.data[0][-1] == 1.0


def test_a_recording_is_scrubbed_and_played_to_its_end(by_hand, jaw_recording, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(pages, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with RecordingPage(jaw_recording, port=0) as page:
        page._t = 2.0
        page._frame()
        assert "t = 2.00 s" in page._page._status.content
        page._play.value, page._speed.value = True, "20"
        now[0] += 1.0
        page._frame()
        assert page._t == pytest.approx(jaw_recording.t[-1])
        assert page._slider.value == pytest.approx(jaw_recording.t[-1])
        assert not page._play.value
        page._play.value = True  # once more
        now[0] += 0.02
        page._frame()
        assert page._t < 1.0
        assert page._play.value


def test_the_plots_of_a_recording_end_where_it_is(by_hand):
    t = np.arange(30_000) / 1e3
    columns = {"t": t, "measured/jaw": np.sin(t)}
    with RecordingPage(Recording.from_columns(columns, "davinci_grasper"), port=0) as page:
        assert page._t == pytest.approx(29.999, abs=0.01)  # a recording opens with its first minute
        for at in (0.0, 5.0, 17.3, 29.999):
            window = page._samples.window(at, 10.0).thinned()
            assert window.t[-1] == pytest.approx(at)
            assert window.t[0] >= at - 10.001
            assert len(window) <= 650


def test_nothing_is_shared_with_the_outside(page):
    assert page._page._server.request_share_url(verbose=False) is None
    assert page._page._server._share_tunnel is None


def test_a_closed_page_lets_the_arm_and_the_port_go(by_hand, lagging_arm, capsys):
    before = sys.getswitchinterval()
    with ArmPage(lagging_arm, port=0) as page:
        port = int(page.url.rpartition(":")[2])
        assert sys.getswitchinterval() <= 5e-4 + 1e-9
    assert sys.getswitchinterval() == before
    _move(lagging_arm)
    assert not page._inbox
    with socket.create_server(("127.0.0.1", port)):
        pass
    assert capsys.readouterr().out == ""


def test_a_page_that_fails_says_so_and_lets_the_arm_go_on(page, lagging_arm, monkeypatch, caplog):
    loop = LOOP.__get__(page)
    with monkeypatch.context() as patch:
        patch.setattr(page, "_row", lambda condition: 1 / 0)
        loop()
    assert "the page has stopped</b> division by zero" in page._page._status.content
    assert "page has stopped, the arm goes on: division by zero" in caplog.text
    _move(lagging_arm)
    assert not page._inbox


def test_another_joint_can_be_looked_at_while_the_arm_stands(page, lagging_arm):
    for _ in range(6):
        _move(lagging_arm)
        page._frame()
    for _ in range(PLOT_EVERY):
        page._frame()  # nothing new
    page._page._joint.value = "elbow"
    page._page._replot()
    plot = next(iter(page._page._plots.values()))
    assert plot.title == "elbow [deg]"
    assert len(plot.data[0]) == 6


def test_the_page_of_an_arm_is_drawn_by_a_process_of_its_own(
    lagging_arm, tmp_path, monkeypatch, caplog
):
    (tmp_path / "viser.py").write_text("raise SystemExit('a stranger')")
    monkeypatch.chdir(tmp_path)  # whose modules are not the page's
    with ArmPage(lagging_arm, port=0) as page:
        shown = page._page
        assert shown.pid != os.getpid()
        shown.say(CommandRefused("no"))
        for _ in range(2):
            with urllib.request.urlopen(page.url, timeout=20) as answer:  # noqa: S310
                assert answer.status == 200
            os.kill(shown.pid, signal.SIGINT)  # as Ctrl-C in the terminal of both
        os.kill(shown.pid, signal.SIGKILL)
        page._thread.join(20)
        assert "the monitor's page has stopped, the arm goes on" in caplog.text
        _move(lagging_arm)
        assert not page._inbox
    with pytest.raises(BrokenPipeError):
        shown.show(None, Condition("ENABLED"))
    with pytest.raises(TruejointError, match=r"203\.0\.113\.9, port 0: cannot listen there"):
        PageProcess(lagging_arm.robot, print, host="203.0.113.9", port=0)


def test_a_row_is_told_as_it_is(jaw_recording, jaw_model):
    samples = Samples.of_recording(jaw_recording, jaw_model).rows(slice(3, 4))
    samples.truth[:] = np.nan
    told = _samples(json.loads(json.dumps(_plain(samples))))
    for name, value in vars(samples).items():
        np.testing.assert_array_equal(getattr(told, name), value)
        if isinstance(value, np.ndarray):
            assert getattr(told, name).dtype == value.dtype


NAMELESS = """
[...document.querySelectorAll('button, [role=slider], input')]
    .filter(e => !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length))
    .map(e => e.outerHTML)
"""


def test_a_screen_reader_can_say_what_each_control_of_a_recording_is(jaw_recording, browser):
    with RecordingPage(jaw_recording, port=0) as page:
        browser.open(page.url)
        browser.until("document.querySelector('[role=slider][aria-label*=T]') !== null")
        thumb = "document.querySelector('[role=slider]').getAttribute('aria-label')"
        assert browser.evaluate(thumb) == "Time [s]"
        assert browser.evaluate(NAMELESS) == []
        assert browser.errors == []


def test_in_a_browser_the_numbers_follow_and_the_button_pauses(lagging_arm, browser):
    with ArmPage(lagging_arm, port=0) as page:
        _move(lagging_arm)
        browser.open(page.url)
        browser.until("document.querySelectorAll('#joints tbody tr').length === 7")
        for way in (0.02, 0.04):
            lagging_arm.move_jp(lagging_arm.robot.home + way * np.eye(7)[0]).wait()
            reported = np.degrees(lagging_arm.measured_js().position[0])
            cell = "document.querySelector('#joints tbody td:nth-child(2)').innerText"
            browser.until(f"Math.abs({cell} - {reported}) < 0.02")
        browser.until("Object.keys(window.__viserTestpoints?.uplots ?? {}).length >= 2")
        browser.evaluate(
            "[...document.querySelectorAll('button')]"
            ".find(b => b.innerText.trim() === 'Pause the arm').click()"
        )
        browser.until("document.querySelector('#status').innerText.startsWith('PAUSED')")
        assert lagging_arm.operating_state().state == "PAUSED"
        assert browser.evaluate(NAMELESS) == []
        assert browser.errors == []
        outside = [u for u in browser.requested if not u.startswith(("data:", "blob:"))]
        assert {u.partition("://")[2].partition("/")[0] for u in outside} == {
            page.url.partition("://")[2]
        }
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page.url, timeout=20)  # noqa: S310
