"""Records and lists of checksums see every change of a value, and survive a killed run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scenetruth.dataset.checksums import (
    check_listed,
    dump_record,
    file_sha256,
    list_path,
    load_record,
    refuse_unlike_checksum,
    write_with_checksums,
)
from scenetruth.errors import StoreError

RECORD = {"sample": 3, "depth": 0.1 + 0.2, "name": "Blättchen", "none": None, "list": [1, 2.5, {"a": True}]}


def test_each_bit_of_a_record_that_changes_a_value_is_seen() -> None:
    text = dump_record(RECORD).encode()
    assert load_record(text, required=True) == RECORD
    unseen = 0
    for place in range(8 * len(text)):
        flipped = bytearray(text)
        flipped[place // 8] ^= 1 << place % 8
        try:
            found = load_record(bytes(flipped), required=True)
        except ValueError:
            continue
        assert found == RECORD
        unseen += 1
    # White space has no meaning.
    assert unseen < 0.05 * 8 * len(text)


def test_a_record_without_a_checksum_is_of_an_earlier_version() -> None:
    text = json.dumps(RECORD).encode()
    assert load_record(text) == RECORD
    with pytest.raises(ValueError, match="has no checksum"):
        load_record(text, required=True)
    with pytest.raises(ValueError, match="not a record"):
        load_record(b"[1]")


def test_lists_are_those_of_sha256sum_and_name_what_changed(tmp_path: Path) -> None:
    table, other = tmp_path / "table.parquet", tmp_path / "settings.json"
    other.write_text("{}")
    write_with_checksums({table: lambda path: path.write_text("1")}, also=[other])
    assert list_path(table).read_text() == f"{file_sha256(table)}  table.parquet\n{file_sha256(other)}  settings.json\n"
    assert check_listed(list_path(table), [table], "remedy") == []
    refuse_unlike_checksum(table, "remedy")
    table.write_text("2")
    other.unlink()
    assert [name for name, _ in check_listed(list_path(table), [table], "remedy")] == ["table.parquet", "settings.json"]
    with pytest.raises(StoreError, match=r"table\.parquet: has changed.*remedy"):
        refuse_unlike_checksum(table, "remedy")
    list_path(table).write_text("nonsense\n")
    assert "is damaged" in check_listed(list_path(table), [table], "remedy")[0][1]
    list_path(table).unlink()
    assert "has no checksum" in check_listed(list_path(table), [table], "remedy")[0][1]
    refuse_unlike_checksum(table, "remedy")


def test_a_run_killed_while_it_replaces_files_leaves_no_mismatch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After each single step, the files match the list."""
    from scenetruth.output import write_atomically

    one, two = tmp_path / "one.json", tmp_path / "two.json"

    def write(text: str) -> None:
        write_with_checksums({one: lambda path: path.write_text(text), two: lambda path: path.write_text(text)})

    write("former")
    states = set()

    class _Watched:
        def __init__(self, target: Path, *, overwrite: bool) -> None:
            self.target, self.inner = target, write_atomically(target, overwrite=overwrite)

        def __enter__(self) -> Path:
            return self.inner.__enter__()

        def __exit__(self, *error: object) -> None:
            self.inner.__exit__(*error)  # type: ignore[arg-type]
            states.add((one.read_text(), two.read_text()))
            assert check_listed(list_path(two), [one, two], "remedy") == [], self.target

    monkeypatch.setattr("scenetruth.dataset.checksums.write_atomically", _Watched)
    write("new")
    assert states == {("former", "former"), ("new", "former"), ("new", "new")}
    assert len(list_path(two).read_text().splitlines()) == 2
