"""Warnings of zarr that users need not hear, from several threads at a time."""

from __future__ import annotations

import threading
import warnings

import pytest
import zarr.errors

from scenetruth.storage.zarr_layout import without_warnings


def _warn() -> None:
    warnings.warn("not in the specification", zarr.errors.ZarrUserWarning, stacklevel=2)


@pytest.mark.filterwarnings("error")
def test_a_thread_that_leaves_does_not_make_another_hear_them() -> None:
    before = list(warnings.filters)
    entered, left = threading.Event(), threading.Event()
    raised: list[Warning] = []

    def second() -> None:
        with without_warnings():
            entered.set()
            left.wait(10)
            try:
                _warn()
            except Warning as warning:
                raised.append(warning)

    thread = threading.Thread(target=second)
    with without_warnings():
        thread.start()
        entered.wait(10)
        _warn()
    left.set()
    thread.join(10)
    assert raised == []
    assert list(warnings.filters) == before
    with pytest.raises(zarr.errors.ZarrUserWarning):
        _warn()
