"""Differences between what two checkouts have made, with renamed names mapped."""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from comparison_renames import BETWEEN, Renames, segments_of

__all__ = ["ASPECTS", "Comparison"]

ASPECTS = ("prose", "hashes", "bytes")
"""What can be left out: texts for readers, hashes of inputs, bytes of files whose content is compared too."""
_PROSE_WORDS = 3
_LONGEST = 160
_MOST_PAIRS = 4
_HASH = re.compile(r"[0-9a-f]{16}")
_DIGEST = re.compile(r"[0-9]+ bytes, sha256 [0-9a-f]+")
_PLOT = re.compile(
    r":(?:.*/)?(?:figures[^/]*|plots)/[^/]*[.]png$|(?:emva1288 / folder / files:[^/]*|/(?:worth|assessment))[.]png$"
)
_WORD_LISTS = ("flag_meanings",)
_TITLES = ("title",)
"""Names of fields and columns whose texts are meant to be read, however short."""


class Comparison:
    """What differs between two results of one part.

    Parameters
    ----------
    before, after
        Files of the results.
    renames
        The table of renamed names.
    without
        Aspects that are left out.
    tolerance
        Of kept arrays, relative to values above 1.
    """

    def __init__(
        self, before: Path, after: Path, renames: Renames, without: frozenset[str], tolerance: float = 0.0
    ) -> None:
        self._renames, self._without, self._tolerance = renames, without, tolerance
        one, other = (json.loads(path.read_text(encoding="utf-8")) for path in (before, after))
        self._kept = _arrays(before), _arrays(after)
        self.left_out: Counter[str] = Counter()
        self.count = 0
        self._changed: list[str] = []
        old, new = (self._entries(found["entries"]) for found in (one, other))
        self._failures = [
            f"FAILED {side}: {key}: {_last(text)}"
            for side, found in (("before", one), ("after", other))
            for key, text in found["failures"].items()
        ]
        self._gone = self._compare(old, new)
        self.decided: Counter[str] = Counter()
        self._changed = self._undecided(self._changed)
        self._gone = self._undecided(self._gone, "only before: ")
        new = dict.fromkeys(self._undecided(sorted(new), "only after: "))
        self._only_after = len(new)
        self.lines = [*self._failures, *self._changed, *_grouped("only before", self._gone)]
        self.lines += _grouped("only after", list(new))

    def summary(self) -> str:
        """Return the numbers of entries."""
        decided = f", {self.decided.total()} decided changes" if self.decided else ""
        if not self.lines:
            return f"equal ({self.count} entries{decided})"
        return (
            f"{self.count} entries compared, {len(self._changed)} differ, {len(self._gone)} only before, "
            f"{self._only_after} only after, {len(self._failures)} failed{decided}"
        )

    def _undecided(self, lines: Sequence[str], title: str = "") -> list[str]:
        """Return the lines that no decided change of the table explains; the others are counted."""
        found = []
        for line in lines:
            reason = self._renames.decided_change(title + line)
            if reason:
                self.decided[reason] += 1
            else:
                found.append(line)
        return found

    def _entries(self, entries: dict[str, Any]) -> dict[str, Any]:
        """Return the entries without those that are volatile or of an aspect that is left out."""
        found: dict[str, Any] = {}
        touched: set[str] = set()
        for key, value in entries.items():
            names = [name for _, name in segments_of(key)]
            volatile = self._renames.volatile_name(names) or self._volatile_of_table(value)
            if volatile:
                segments = key.split(BETWEEN)
                touched.update(BETWEEN.join(segments[:number]) for number in range(1, len(segments) + 1))
            if volatile and not (isinstance(value, dict) and "table" in value):
                self.left_out[volatile] += 1
            elif self._aspect(key, names, value) not in self._without:
                found[key] = value
        # The bytes of a file differ where its content does by what is volatile.
        for key in [key for key in found if key.partition(BETWEEN)[2] in touched and key.startswith("bytes")]:
            del found[key]
            self.left_out["bytes of files with such names"] += 1
        return found

    def _volatile_of_table(self, value: Any) -> str:
        """Return a volatile name in a table; empty if there is none."""
        if not (isinstance(value, dict) and "table" in value):
            return ""
        columns, rows = value["table"]["columns"], value["table"]["rows"]
        words = {one for row in rows for one in row if isinstance(one, str)}
        return next(iter(sorted(self._renames.volatile & set(columns) | self._renames.volatile_rows & words)), "")

    def _aspect(self, key: str, names: Sequence[str], value: Any) -> str:
        if key.split(BETWEEN)[0] in ("prose", "bytes"):
            return key.split(BETWEEN)[0]
        if isinstance(value, str) and _DIGEST.fullmatch(value):
            return "prose" if _PLOT.search(key) else ""
        last = next((name for name in reversed(names) if not name.isdigit()), "")
        if last.endswith("_hash") or (isinstance(value, str) and _HASH.fullmatch(value)):
            return "hashes"
        if last in ("sha256", "bytes", "contentSize") or last.endswith(("_sha256", "_bytes")):
            return "bytes"
        return "prose" if last in _TITLES or (_is_prose(value) and last not in _WORD_LISTS) else ""

    def _compare(self, old: dict[str, Any], new: dict[str, Any]) -> list[str]:
        """Compare; entries that both sides have are taken out of ``new``."""
        gone = []
        rest = set(new)
        for key, value in old.items():
            target = next((one for one in self._renames.keys(key) if one in rest), None)
            if target is None:
                gone.append(key)
                continue
            rest.discard(target)
            self.count += 1
            if target != key:
                self._renames.used[f"{key} -> {target}"] += 1
            self._changed += [_shown(key, line) for line in self._differences(key, value, new[target])]
        for key in set(new) - rest:
            del new[key]
        return gone

    def _differences(self, key: str, one: Any, other: Any) -> Iterator[str]:
        parents = [name for _, name in segments_of(key)]
        if isinstance(one, dict) and isinstance(other, dict) and set(one) == set(other) == {"array"}:
            yield from self._of_arrays(one["array"], other["array"], parents)
        elif isinstance(one, dict) and isinstance(other, dict) and set(one) == set(other) == {"table"}:
            yield from self._of_tables(one["table"], other["table"], parents)
        elif not self._renames.is_same(one, other, parents):
            yield _change(one, other)

    def _of_arrays(self, one: dict[str, Any], other: dict[str, Any], parents: Sequence[str]) -> Iterator[str]:
        for name in ("dims", "shape", "dtype", "values"):
            if not self._renames.is_same(one.get(name), other.get(name), parents):
                yield f"{name}: {_change(one.get(name), other.get(name))}"
        if one.get("sha") == other.get("sha") or one["shape"] != other["shape"]:
            return
        if "kept" in one and "kept" in other:
            yield from _of_values(self._kept[0][one["kept"]], self._kept[1][other["kept"]], self._tolerance)
            return
        changed = [name for name in ("finite", "min", "max", "mean") if one.get(name) != other.get(name)]
        yield "values differ; " + (
            ", ".join(f"{name} {_change(one.get(name), other.get(name))}" for name in changed) or "the same min and max"
        )

    def _of_tables(self, one: dict[str, Any], other: dict[str, Any], parents: Sequence[str]) -> Iterator[str]:
        columns = self._columns(one["columns"], other["columns"], parents)
        if gone := [name for name in one["columns"] if name not in columns]:
            yield f"columns only before: {', '.join(gone)}"
        if new := [name for name in other["columns"] if name not in columns.values()]:
            yield f"columns only after: {', '.join(new)}"
        columns = {name: new for name, new in columns.items() if self._is_compared(name)}
        old_rows = list(self._rows(one, list(columns)))
        new_rows = list(self._rows(other, list(columns.values())))
        if len(old_rows) != len(new_rows):
            yield f"rows: {len(old_rows)} -> {len(new_rows)}"
        words = [{row[place] for row in new_rows if isinstance(row[place], str)} for place in range(len(columns))]
        waiting: dict[str, list[int]] = defaultdict(list)
        for place, row in enumerate(new_rows):
            waiting[_identity(row)].append(place)
        order, lost = [], []
        for place, row in enumerate(old_rows):
            name = self._identity(row, list(columns), words, parents)
            if not waiting.get(name):
                lost.append(name)
                continue
            order.append(waiting[name].pop(0))
            for column, value, found in zip(columns, row, new_rows[order[-1]], strict=True):
                if not self._renames.is_same(value, found, [*parents, column]):
                    yield f"row {place} ({name}), {column}: {_change(value, found)}"
        if lost:
            yield f"rows only before: {len(lost)}: {_short('; '.join(lost))}"
        if order != sorted(order):
            yield "the order of rows differs"

    def _columns(self, old: Sequence[str], new: Sequence[str], parents: Sequence[str]) -> dict[str, str]:
        """Return the columns that both tables have: name before to name after."""
        if set(old) <= set(new):
            return {name: name for name in old}
        found: dict[str, str] = {}
        for name in old:
            # Two old names must not take one new column.
            free = (one for one in self._renames.names("columns", name, parents) if one in new)
            if (taken := next((one for one in free if one not in found.values()), None)) is not None:
                found[name] = taken
        return found

    def _identity(
        self, row: Sequence[Any], columns: Sequence[str], words: Sequence[set[str]], parents: Sequence[str]
    ) -> str:
        """Return what a row of the table before is called in the table after."""
        renamed = list(row)
        for place, value in enumerate(row):
            if isinstance(value, str):
                names = self._renames.names("values", value, [*parents, columns[place]])
                renamed[place] = next((one for one in names if one in words[place]), value)
        return _identity(renamed)

    def _is_compared(self, column: str) -> bool:
        if column in self._renames.volatile:
            self.left_out[column] += 1
            return False
        return self._aspect(column, [column], None) not in self._without

    def _rows(self, table: dict[str, Any], columns: Sequence[str]) -> Iterator[list[Any]]:
        """Give the rows with some columns; texts that are prose are blank where prose is left out."""
        places = [table["columns"].index(name) for name in columns]
        for row in table["rows"]:
            if volatile := [value for value in row if isinstance(value, str) and value in self._renames.volatile_rows]:
                self.left_out[f"rows of {volatile[0]}"] += 1
                continue
            blank = "prose" in self._without
            yield ["" if blank and _is_prose(row[place]) else row[place] for place in places]


def _identity(row: Sequence[Any]) -> str:
    """Return the words of a row: no numbers, sentences, hashes or lists."""
    words = [value for value in row if isinstance(value, str) and value[:1] not in ("[", "{")]
    return ", ".join(value for value in words if not _is_prose(value) and not _HASH.match(value))


def _is_prose(value: Any) -> bool:
    """Return whether a value is a text of several words, or a list with such a text in it."""
    if isinstance(value, list):
        return any(isinstance(one, str) and _is_prose(one) for one in value)
    return isinstance(value, str) and len(value.split()) > _PROSE_WORDS and value[:1] not in ("[", "{")


def _of_values(one: np.ndarray[Any, Any], other: np.ndarray[Any, Any], tolerance: float) -> Iterator[str]:
    if one.dtype.kind in "iub" and other.dtype.kind in "iub" and one.shape == other.shape:
        changed = np.asarray(one != other)
        pairs = Counter(zip(one[changed].tolist(), other[changed].tolist(), strict=True))
        if pairs and len(pairs) <= _MOST_PAIRS:
            yield "; ".join(f"{a} -> {b} at {count} of {one.size} places" for (a, b), count in sorted(pairs.items()))
            return
    a, b = (np.asarray(item, dtype=np.float64) for item in (one, other))
    if (np.isfinite(a) != np.isfinite(b)).any():
        yield f"valid pixels differ: {int((np.isfinite(a) != np.isfinite(b)).sum())} of {a.size}"
        return
    with np.errstate(invalid="ignore"):
        size = np.nan_to_num(np.abs(a - b), nan=0.0, posinf=0.0)
    worst = float((size / np.maximum(1, np.abs(np.nan_to_num(a)))).max(initial=0.0))
    if worst > tolerance or tolerance == 0:
        yield f"differs by up to {worst:.3g} at {int((size > 0).sum())} of {a.size} places"


def _arrays(file: Path) -> list[np.ndarray[Any, Any]]:
    file = file.with_suffix(".npz")
    if not file.exists():
        return []
    with np.load(file) as found:
        return [found[f"arr_{number}"] for number in range(len(found.files))]


def _change(one: Any, other: Any) -> str:
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = [(a, b) for a, b in zip(one, other, strict=True) if a != b]
        if pairs:
            return f"{_short(pairs[0][0])} -> {_short(pairs[0][1])}" + (
                f" and {len(pairs) - 1} more" if len(pairs) > 1 else ""
            )
    return f"{_short(one)} -> {_short(other)}"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def _shown(key: str, line: str) -> str:
    return f"{key}: {line}"


def _last(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return next((line for line in reversed(lines) if not line.startswith(" ")), lines[-1] if lines else "")


def _grouped(title: str, keys: Sequence[str]) -> list[str]:
    """Return lines for keys; those that differ in their last segments alone share a line."""
    groups: dict[str, list[str]] = defaultdict(list)
    for key in keys:
        head, _, tail = key.rpartition(BETWEEN)
        groups[head].append(tail)
    return [f"{title}: {head}{BETWEEN if head else ''}{_short(', '.join(tails))}" for head, tails in groups.items()]
