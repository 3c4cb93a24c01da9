"""One thread of linear algebra, and as many as before afterwards."""

from threadpoolctl import threadpool_info, threadpool_limits

from truejoint.threads import one_thread


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
