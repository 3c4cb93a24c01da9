"""`truejoint doctor live`, on topics within this process."""

from tests.recordings.said import PROFILE, STATE, SaidRos, told_session

from truejoint.crtk import ros

LIVE = f"doctor live --robot raven2 --profile {PROFILE.name}"


class Interrupted(SaidRos):
    """Says all, and then somebody presses Ctrl-C."""

    @property
    def is_over(self) -> bool:
        self.say_all(told_session())
        raise KeyboardInterrupt

    @is_over.setter
    def is_over(self, value: bool) -> None:
        pass


def test_it_says_what_it_heard_until_ctrl_c(call, monkeypatch):
    monkeypatch.setattr(ros, "open_transport", lambda *_: Interrupted())
    found = call.good(LIVE)
    assert "stopped after" in found.err
    lines = found.out.splitlines()
    assert lines[0].startswith(f"good link: {STATE} 29.")
    assert len(lines) == 16
