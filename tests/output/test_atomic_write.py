"""Results come whole under their names, earlier ones stay until then, and nobody else's file is ever lost."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import scenetruth as st
from scenetruth.output import (
    OwnershipResult,
    atomic_write,
    check_output,
    lock_output,
    remove_leftovers,
    write_atomically,
)
from scenetruth.output.atomic_write import exchange
from scenetruth.output.locks import Writer, this_writer, written_by

DEAD = Writer(this_writer().host, 2**22 + 1, 1)
ELSEWHERE = Writer("00000000", 1, 1)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def claim(path: Path) -> OwnershipResult:
    """Claim folders with a file `ours`; all else in them is foreign."""
    if not (path / "ours").exists():
        return OwnershipResult("is not ours")
    return OwnershipResult(foreign=tuple(name for name in names(path) if name != "ours"))


def make(folder: Path, ours: str, **foreign: str) -> Path:
    folder.mkdir()
    for name, text in {"ours": ours, **foreign}.items():
        (folder / name).write_text(text)
    return folder


def write(target: Path, text: str = "new") -> None:
    with write_atomically(target, overwrite=True, claim=claim) as place:
        make(place, text)


def test_a_writer_is_alive_until_it_ends() -> None:
    assert not this_writer().is_dead
    assert DEAD.is_dead
    # Of another machine, nobody can tell.
    assert not ELSEWHERE.is_dead
    # Another process has got the number since.
    assert Writer(this_writer().host, os.getpid(), this_writer().start - 1).is_dead
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    from scenetruth.output.locks import _read_start_time

    writer = Writer(this_writer().host, child.pid, _read_start_time(child.pid))
    assert not writer.is_dead
    child.kill()
    # It counts as dead before anybody has asked for its result.
    deadline = time.monotonic() + 10
    while not writer.is_dead and time.monotonic() < deadline:
        time.sleep(0.01)
    assert writer.is_dead
    child.communicate()
    assert written_by("no-writer-here") is None


def test_foreign_files_stay(tmp_path: Path) -> None:
    make(tmp_path / "x", "old", thesis="all my work")
    write(tmp_path / "x")
    assert names(tmp_path / "x") == ["ours", "thesis"]
    assert (tmp_path / "x" / "ours").read_text() == "new"
    assert (tmp_path / "x" / "thesis").read_text() == "all my work"
    assert names(tmp_path) == ["x"]


def test_what_is_not_ours_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "thesis").write_text("all my work")
    with pytest.raises(st.OutputExistsError, match="is not ours; only results of scenetruth are replaced"):
        check_output(tmp_path / "x", overwrite=True, claim=claim)
    with pytest.raises(st.OutputExistsError), write_atomically(tmp_path / "x", overwrite=True, claim=claim):
        pytest.fail("the work has begun")
    assert (tmp_path / "x" / "thesis").read_text() == "all my work"
    # An empty folder is nobody's.
    (tmp_path / "y").mkdir()
    with write_atomically(tmp_path / "y") as place:
        make(place, "new")
    assert names(tmp_path / "y") == ["ours"]


@pytest.mark.parametrize("can_exchange", [True, False])
def test_failure_at_any_step_of_the_replacement_keeps_one_result_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, can_exchange: bool
) -> None:
    """A stand-in for being killed: whatever touches the disk raises from its n-th call on, clearing up included."""

    class KilledError(BaseException):
        pass

    survived = False
    for calls in range(1, 40):
        folder = tmp_path / f"{calls}"
        folder.mkdir()
        make(folder / "x", "old", thesis="all my work")
        left = calls

        def dying(function: Any) -> Any:
            def call(*arguments: Any, **keywords: Any) -> Any:
                nonlocal left
                left -= 1
                if left <= 0:
                    raise KilledError
                return function(*arguments, **keywords)

            return call

        with monkeypatch.context() as patch:
            if not can_exchange:
                patch.setattr(atomic_write, "exchange", lambda one, other: False)
            else:
                patch.setattr(atomic_write, "exchange", dying(exchange))
            for name in ("rename", "unlink", "rmdir", "mkdir"):
                patch.setattr(Path, name, dying(getattr(Path, name)))
            patch.setattr(shutil, "rmtree", dying(shutil.rmtree))
            patch.setattr(atomic_write, "_clear_up", dying(atomic_write._clear_up))
            patch.setattr(atomic_write, "this_writer", lambda: DEAD)
            try:
                write(folder / "x")
                survived = True
            except (KilledError, PermissionError):
                pass
        # The next run finds an earlier or a new result, whole, and tidies up.
        with lock_output(folder / "x", claim):
            pass
        assert names(folder) == ["x"], calls
        assert (folder / "x" / "ours").read_text() in ("old", "new")
        assert (folder / "x" / "thesis").read_text() == "all my work"
        write(folder / "x", "newer")
        assert (folder / "x" / "ours").read_text() == "newer"
        assert names(folder) == ["x"]
        if survived:
            return
    pytest.fail("never came to the end")


def test_leftovers_of_dead_writers_are_swept_and_others_kept(tmp_path: Path) -> None:
    make(tmp_path / "x", "old")
    for writer in (DEAD, ELSEWHERE):
        make(tmp_path / f".x.partial-{writer}", "half")
    make(tmp_path / f".y.partial-{DEAD}", "half")
    (tmp_path / ".x.partial-thoughts").write_text("mine")
    write(tmp_path / "x")
    kept = {"x", f".x.partial-{ELSEWHERE}", f".y.partial-{DEAD}", ".x.partial-thoughts"}
    assert set(names(tmp_path)) == kept
    remove_leftovers(tmp_path, claim)
    assert set(names(tmp_path)) == kept - {f".y.partial-{DEAD}"}


def test_an_earlier_result_whose_removal_was_interrupted_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of it may be gone, and with it what told that it was ours."""
    make(tmp_path / "x", "old")

    class KilledError(Exception):
        pass

    def halfway(path: Path, **_: object) -> None:
        (path / "ours").unlink()
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(atomic_write, "this_writer", lambda: DEAD)
        patch.setattr(shutil, "rmtree", halfway)
        patch.setattr(atomic_write, "_clear_up", lambda path: None)
        with pytest.raises(KilledError):
            write(tmp_path / "x")
    assert len(names(tmp_path)) == 2
    with lock_output(tmp_path / "x", claim):
        pass
    assert names(tmp_path) == ["x"]
    assert (tmp_path / "x" / "ours").read_text() == "new"


def test_an_earlier_result_is_restored(tmp_path: Path) -> None:
    make(tmp_path / f".x.replaced-{DEAD}", "old")
    with pytest.raises(st.OutputExistsError, match="exists already"), write_atomically(tmp_path / "x", claim=claim):
        pytest.fail("the work has begun")
    assert (tmp_path / "x" / "ours").read_text() == "old"


def test_files_that_cannot_go_to_the_new_result_stay_where_they_are(tmp_path: Path) -> None:
    make(tmp_path / "x", "new", thesis="version 2")
    make(tmp_path / f".x.replaced-{DEAD}", "old", thesis="version 1", notes="mine")
    with lock_output(tmp_path / "x", claim):
        pass
    assert (tmp_path / "x" / "thesis").read_text() == "version 2"
    assert (tmp_path / "x" / "notes").read_text() == "mine"
    assert names(tmp_path / f".x.replaced-{DEAD}") == ["thesis"]


HOLDER = """
import sys
from pathlib import Path
from scenetruth.output import write_atomically
with write_atomically(Path(sys.argv[1])) as place:
    place.mkdir()
    print("writing", flush=True)
    input()
"""


def test_the_second_writer_is_told_and_a_dead_one_does_not_matter(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "x"
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, target], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "writing\n"
    message = rf"is being written by another run \(process {holder.pid}\); wait until it has ended"
    with pytest.raises(st.OutputExistsError, match=message), write_atomically(target, overwrite=True):
        pytest.fail("the work has begun")
    assert any(name.startswith(".x.partial-") for name in names(target.parent))
    holder.kill()
    holder.communicate()
    assert ".x.lock" in names(target.parent)
    with write_atomically(target) as place:
        make(place, "new")
    assert names(target.parent) == ["x"]


def test_threads_of_one_process_are_told_too(tmp_path: Path) -> None:
    told: list[BaseException] = []

    def second() -> None:
        try:
            with write_atomically(tmp_path / "x"):
                pass
        except st.OutputExistsError as error:
            told.append(error)

    with lock_output(tmp_path / "x"), write_atomically(tmp_path / "x") as place:
        place.write_text("new")
        thread = threading.Thread(target=second)
        thread.start()
        thread.join()
    assert len(told) == 1
    assert names(tmp_path) == ["x"]


def test_folders_that_were_made_for_nothing_go(tmp_path: Path) -> None:
    with contextlib.suppress(RuntimeError), write_atomically(tmp_path / "a" / "b" / "x"):
        raise RuntimeError
    assert names(tmp_path) == []


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path) -> None:
    make(tmp_path / "x", "old")

    def fill() -> None:
        with write_atomically(tmp_path / "x", overwrite=True, claim=claim) as place:
            make(place, "new")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(st.StoreError, match="the disk is full; nothing was written"):
        fill()
    assert names(tmp_path) == ["x"]
    assert (tmp_path / "x" / "ours").read_text() == "old"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_for_real(tmp_path: Path) -> None:
    def fill() -> None:
        with write_atomically(tmp_path / "score.json") as place:
            place.symlink_to("/dev/full")
            with place.open("w") as file:
                file.write("x" * 100_000)

    with pytest.raises(st.StoreError, match="the disk is full"):
        fill()
    assert names(tmp_path) == []


def test_writers_that_finish_late_leave_nothing_behind(tmp_path: Path) -> None:
    writers = []

    def write_late(place: Path) -> None:
        deadline = time.monotonic() + 0.3
        while time.monotonic() < deadline:
            # The folder may be cleared away between the two, which is what this is about.
            with contextlib.suppress(FileNotFoundError, FileExistsError):
                place.mkdir(exist_ok=True)
                (place / "chunk").write_bytes(b"0")

    with contextlib.suppress(RuntimeError), write_atomically(tmp_path / "x.zarr") as place:
        writers.append(threading.Thread(target=write_late, args=(place,)))
        writers[0].start()
        raise RuntimeError
    writers[0].join()
    assert names(tmp_path) == []


def test_places_where_nothing_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for target, message in (
        (tmp_path / "file" / "x", "cannot be created, because .*file is not a directory"),
        (tmp_path / "dangling", "is a link to .*nothing, which does not exist"),
        (tmp_path / ("x" * 255), "has a name of 255 bytes, [0-9]+ more than the maximum"),
        (tmp_path / "a\0b", "is not a valid output path"),
        (Path(), "is the current directory, or contains it"),
        (tmp_path, "is the current directory, or contains it"),
        (Path("/"), "is the root of a file system"),
        (Path("/proc/x"), "cannot be (made|written)"),
    ):
        with pytest.raises(st.StoreError, match=message), write_atomically(target, overwrite=True):
            pytest.fail(f"{target}: the work has begun")
    assert names(tmp_path) == ["dangling", "file", "here"]


def test_the_root_can_be_looked_at() -> None:
    with lock_output(Path("/")):
        pass


def test_links_stay_and_what_they_point_to_is_replaced(tmp_path: Path) -> None:
    make(tmp_path / "disk", "old")
    (tmp_path / "x").symlink_to(tmp_path / "disk")
    write(tmp_path / "x")
    assert (tmp_path / "x").is_symlink()
    assert (tmp_path / "disk" / "ours").read_text() == "new"
