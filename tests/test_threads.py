"""Work that is shared among threads is all done once, whatever their number, and also where it shares work again."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from scenetruth import compilation, threads
from tests.helpers.nightly import nightly


@given(count=st.integers(0, 5000), number=st.integers(1, 5), least=st.integers(1, 2000))
def test_bands_take_every_index_once(count: int, number: int, least: int) -> None:
    taken: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
    bands = []

    def kernel(low: int, high: int, out: NDArray[np.int64], step: int) -> None:
        assert low < high
        bands.append(high - low)
        out[low:high] += step

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compilation, "thread_count", lambda: number)
        threads.in_bands(kernel, count, taken, 3, least=least)
    assert (taken == 3).all()
    # No band that is not worth a thread, and no more bands than even out their cost.
    assert min(bands, default=count) >= min(least, count)
    assert len(bands) <= 2 * number
    if number == 1 or count < 2 * least:
        assert len(bands) <= 1


def test_bands_are_done_in_several_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    import threading

    monkeypatch.setattr(compilation, "thread_count", lambda: 2)
    met = threading.Barrier(2)
    names = set()

    def kernel(low: int, high: int) -> None:
        if low in (0, 1):
            met.wait(timeout=20)
        names.add(threading.current_thread().name)

    threads.in_bands(kernel, 4, least=1)
    assert len(names) == 2


def test_work_may_share_its_own_work_among_busy_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    # Each of the callers occupies a thread, and no thread is left to help any of them.
    monkeypatch.setattr(compilation, "thread_count", lambda: 2)

    def inner(total: list[int]) -> None:
        threads.in_threads(total.append, range(8))

    def outer(_: int) -> int:
        totals: list[list[int]] = [[] for _ in range(8)]
        threads.in_threads(inner, totals)
        return sum(sum(total) for total in totals)

    with ThreadPoolExecutor(6) as callers:
        found = list(callers.map(outer, range(24), timeout=60))
    assert found == [8 * 28] * 24


def test_errors_of_threads_are_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "thread_count", lambda: 2)

    def fail(job: int) -> None:
        if job == 1:
            raise ValueError(job)

    with pytest.raises(ValueError, match="1"):
        threads.in_threads(fail, range(3))


@pytest.mark.parametrize("count", [1, 2, 3, 100])
def test_runs_of_rows_cover_all_rows_once(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(compilation, "thread_count", lambda: 3)
    rows = [row for first, last in threads.bands(count) for row in range(first, last)]
    assert rows == list(range(count))


def test_linear_algebra_in_one_thread() -> None:
    from threadpoolctl import threadpool_info, threadpool_limits

    def counts() -> list[int]:
        np.linalg.inv(np.eye(3))
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"):
        before = counts()
        assert set(threads.with_one_blas_thread(counts)()) == {1}
        assert counts() == before


@given(count=st.integers(0, 12), number=st.integers(1, 4), at_once=st.integers(1, 4))
def test_results_come_in_order_and_few_tasks_run_ahead(count: int, number: int, at_once: int) -> None:
    begun: list[int] = []

    def work(job: int) -> int:
        begun.append(job)
        threads.in_threads(lambda _: None, range(3))
        return job * job

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compilation, "thread_count", lambda: number)
        for place, result in enumerate(threads.in_order(work, iter(range(count)), at_once)):
            assert result == place * place
            assert len(begun) <= place + 1 + at_once
    assert sorted(begun) == list(range(count))


def test_no_task_begins_after_an_error_or_without_a_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compilation, "thread_count", lambda: 2)
    begun = []

    def work(job: int) -> int:
        begun.append(job)
        if job == 3:
            raise ValueError(job)
        return job

    results = threads.in_order(work, range(100), 2)
    with pytest.raises(ValueError, match="3"):
        list(results)
    assert len(begun) <= 6
    begun.clear()
    results = threads.in_order(work, range(100), 2)
    next(results)
    results.close()
    assert len(begun) <= 3


@nightly
def test_arrays_of_shared_work_are_freed_while_all_threads_are_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    import gc
    import weakref

    monkeypatch.setattr(compilation, "thread_count", lambda: 2)

    def fill() -> weakref.ref[NDArray[np.float64]]:
        values: NDArray[np.float64] = np.zeros(8)
        threads.in_threads(partial(np.put, values, v=1.0), range(8))
        assert values.all()
        return weakref.ref(values)

    def is_freed(_: int) -> bool:
        gone = fill()
        gc.collect()
        return gone() is None

    # Every thread is busy with a task of its own, so that no helper of `in_threads` starts.
    with ThreadPoolExecutor(4) as callers:
        assert all(callers.map(is_freed, range(20), timeout=60))
    assert all(threads.in_order(is_freed, range(20), 2))
