"""One thread of linear algebra, and short turns; as before afterwards."""

import gc
import sys

from threadpoolctl import threadpool_info, threadpool_limits

from truejoint.threads import one_thread, short_turns


def counts() -> list[int]:
    return [library["num_threads"] for library in threadpool_info()]


def test_libraries_are_found_and_given_back() -> None:
    with threadpool_limits(2):
        before = counts()
        assert 2 in before
        for _ in range(2):  # the second time they are known
            with one_thread():
                assert set(counts()) == {1}
            assert counts() == before


def test_turns_are_short_and_old_objects_are_not_searched() -> None:
    gc.unfreeze()  # of what was there before the first test
    before = sys.getswitchinterval()
    with short_turns():
        assert sys.getswitchinterval() <= 1e-4 + 1e-9
        assert gc.get_freeze_count() > 10_000
        with short_turns():
            pass
        assert gc.get_freeze_count() > 10_000
    assert (sys.getswitchinterval(), gc.get_freeze_count()) == (before, 0)
    gc.freeze()
