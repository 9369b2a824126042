"""Patterns of file names: matching, guesses from the names of a folder, nearest patterns for messages."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from itertools import product
from pathlib import Path

__all__ = [
    "IMAGE_SUFFIXES",
    "INDEX_FIELDS",
    "TIME_FIELD",
    "FilePattern",
    "GuessedPattern",
    "MatchedFile",
    "expected_indices",
    "guess_patterns",
    "list_names",
    "missing_names",
    "nearest_patterns",
    "read_pattern",
]

INDEX_FIELDS = ("s", "t", "row", "pose", "level")
"""Integer fields of a pattern: camera position, frame, row of a grid, pose of a board, exposure level."""
TIME_FIELD = "time"
"""Field of a time stamp, with a format of ``datetime.strptime``: ``{time:%Y%m%d_%H%M%S}``."""
IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
"""Suffixes of image files, in lower case."""

_MOST_FILES = 1_000_000
_MOST_DIGITS = 9
_FIELD = re.compile(r"\{([^{}]*)\}")
_SPEC = re.compile(r"(\+?)(?:0?(\d{1,2}))?d?")
_DIRECTIVES = {"Y": r"\d{4}", "m": r"\d{2}", "d": r"\d{2}", "H": r"\d{2}", "M": r"\d{2}", "S": r"\d{2}",
               "j": r"\d{3}", "f": r"\d{1,6}", "y": r"\d{2}", "%": "%"}  # fmt: skip


@dataclass(frozen=True)
class MatchedFile:
    """A file with the values of the fields in its name; ``time_s`` is the time stamp, if its name has one."""

    name: str
    indices: Mapping[str, int]
    time_s: float | None = None

    def index(self, *fields: str) -> tuple[int, ...]:
        """Return the indices of some fields, 0 for those that the pattern lacks."""
        return tuple(self.indices.get(name, 0) for name in fields)


@dataclass(frozen=True)
class FilePattern:
    """Pattern of the paths of files, relative to a folder, such as ``images/s{s:+d}_t{t:03d}.tif``.

    ``text``: Path with index fields in braces, as in `str.format`, and the wildcards ``*`` and ``?``.
    ``fields``: Names of its fields, in order.
    ``specs``: Format of each field; empty for an integer of any form.
    """

    text: str
    fields: tuple[str, ...]
    specs: tuple[str, ...] = field(repr=False)

    @cached_property
    def _expression(self) -> re.Pattern[str]:
        parts = _FIELD.split(self.text)
        words, number = [], 0
        for place, part in enumerate(parts):
            if place % 2 == 0:
                words.append("".join({"*": "[^/]*", "?": "[^/]"}.get(each, re.escape(each)) for each in part))
                continue
            name, spec = self.fields[number], self.specs[number]
            words.append(f"(?P<{name}>{_time_expression(spec) if name == TIME_FIELD else _expression_of(spec)})")
            number += 1
        return re.compile("".join(words))

    def match(self, name: str) -> MatchedFile | None:
        """Return the fields of a path, or None if the pattern does not match it."""
        found = self._expression.fullmatch(name)
        if found is None:
            return None
        indices, time_s = {}, None
        for part, spec in zip(self.fields, self.specs, strict=True):
            text = found[part]
            if part == TIME_FIELD:
                try:
                    stamp = datetime.strptime(text, spec).replace(tzinfo=UTC)
                except ValueError:
                    return None
                time_s = stamp.timestamp()
                continue
            value = int(text)
            if spec and format(value, spec) != text:
                return None
            indices[part] = value
        return MatchedFile(name, indices, time_s)

    def matches(self, names: Iterable[str]) -> list[MatchedFile]:
        """Return all names that match, in the order of their indices and then of their names."""
        found = [each for each in map(self.match, names) if each is not None]
        return sorted(found, key=lambda each: (each.index(*self.fields), _in_order(each.name)))

    def name(self, **indices: int) -> str:
        """Return the path of one index; fields without an index remain as they are."""
        number = iter(range(len(self.fields)))

        def put(_: re.Match[str]) -> str:
            place = next(number)
            name, spec = self.fields[place], self.specs[place]
            return format(indices[name], spec) if name in indices else f"{{{name}{':' if spec else ''}{spec}}}"

        return _FIELD.sub(put, self.text)


def _expression_of(spec: str) -> str:
    """Return the expression of an integer; of exactly as many characters as the format demands, or of any number."""
    if not spec:
        return rf"[+-]?\d{{1,{_MOST_DIGITS}}}"
    sign, width = _SPEC.fullmatch(spec).groups()  # type: ignore[union-attr]
    least = max(int(width or 1) - (1 if sign else 0), 1)
    return rf"{'[+-]' if sign else '-?'}\d{{{max(least - (0 if sign else 1), 1)},{_MOST_DIGITS}}}"


def _time_expression(spec: str) -> str:
    return re.sub(r"%(.)|(.)", lambda one: _DIRECTIVES[one[1]] if one[1] else re.escape(one[2]), spec)


def read_pattern(text: str, allowed: Collection[str] = INDEX_FIELDS, required: Collection[str] = ()) -> FilePattern:
    """Return the pattern of a text.

    >>> pattern = read_pattern("images/s{s:+d}_t{t:03d}.tif")
    >>> pattern.match("images/s-2_t007.tif").indices, pattern.match("images/s-2_t7.tif")
    ({'s': -2, 't': 7}, None)
    >>> pattern.name(s=1, t=12)
    'images/s+1_t012.tif'

    Raises
    ------
    ValueError
        If a field is not allowed or missing, or its format is not that of an integer; lists every reason.
    """
    problems = []
    if not text.strip() or "\0" in text:
        raise ValueError("must be a path with fields such as {s} and {t}")
    if Path(text).is_absolute() or "\\" in text or ".." in text.split("/"):
        problems.append("must be relative to its folder, with / between folders and without ..")
    rest = _FIELD.sub("", text)
    if "{" in rest or "}" in rest:
        problems.append("has an unpaired brace; fields have the form {s}, {s:+d} or {t:03d}")
    names, specs = [], []
    for inner in _FIELD.findall(text):
        name, _, spec = inner.partition(":")
        names.append(name)
        specs.append(spec)
        if name == TIME_FIELD and TIME_FIELD in allowed:
            unknown = [each for each in re.findall(r"%(.?)", spec) if each not in _DIRECTIVES]
            if not spec or unknown:
                problems.append(
                    f"{{{inner}}} needs a format of time with the directives %{', %'.join(_DIRECTIVES)}, "
                    "such as {time:%Y%m%d_%H%M%S}"
                )
        elif name not in allowed:
            listed = ", ".join(f"{{{each}}}" for each in allowed) or "none"
            near = difflib.get_close_matches(name, list(allowed), n=1, cutoff=0.5)
            hint = f"; did you mean {{{near[0]}}}?" if near else ""
            problems.append(f"has the unknown field {{{name}}}{hint or ';'} fields are {listed}")
        elif spec and (_SPEC.fullmatch(spec) is None or spec in ("+", "0")):
            problems.append(f"{{{inner}}} must have the format of an integer, such as {{{name}:+d}} or {{{name}:03d}}")
    problems += [f"has the field {{{name}}} twice" for name, count in Counter(names).items() if count > 1]
    problems += [f"lacks the field {{{name}}}" for name in required if name not in names]
    between = _FIELD.split(text)[2:-1:2]
    if any(not part for part in between):
        problems.append("has fields without a character between them, which cannot be separated")
    if problems:
        raise ValueError("; ".join(problems))
    return FilePattern(text, tuple(names), tuple(specs))


def list_names(folder: Path, *, suffixes: Sequence[str] = (), most: int = _MOST_FILES) -> list[str]:
    """Return the paths of all files below a folder, relative to it, in natural order; without hidden files.

    ``suffixes``: Suffixes in lower case; any suffix if empty.
    """
    found = []
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        if any(part.startswith(".") for part in name.parts) or (suffixes and path.suffix.lower() not in suffixes):
            continue
        if path.is_file():
            found.append(name.as_posix())
        if len(found) > most:
            msg = f"has more than {most:,} files"
            raise ValueError(msg)
    return sorted(found, key=_in_order)


def _in_order(name: str) -> tuple[tuple[int, str], ...]:
    """Return a key that sorts digits as numbers."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d{1,18})", name))


_NUMBER = re.compile(r"(?<![0-9])[+-]\d+|\d+")
_LETTERS = re.compile(r"([A-Za-z]*)[^A-Za-z0-9/]*$")
_MEANINGS = {
    "s": ("s", "pos", "position", "cam", "camera", "x", "view", "place"),
    "t": ("t", "frame", "f", "time", "img", "image", "im", "n", "scan", "step"),
    "row": ("r", "row", "y", "sy"),
    "pose": ("pose", "p", "board", "cal", "calib", "b"),
    "level": ("level", "e", "exp", "exposure", "l"),
}


@dataclass(frozen=True)
class GuessedPattern:
    """A pattern that matches files of a folder; ``doubts`` lists fields whose meaning follows from no word."""

    text: str
    names: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    def describe(self) -> str:
        """Return the pattern and its number of files for messages."""
        return f"{self.text} ({len(self.names):,} file{'s' if len(self.names) != 1 else ''})"


def guess_patterns(
    names: Sequence[str], fields: Sequence[str] = ("s", "t", "row", "pose", "level")
) -> list[GuessedPattern]:
    """Return patterns that match groups of names, the largest group first.

    Names of one group differ in numbers only. Numbers that are equal in all names stay; others become fields by the
    word before them (``pos3`` is a position), and in doubt by their order.

    >>> [found.text for found in guess_patterns(["pos0_t008.png", "pos0_t010.png", "pos1_t008.png"])]
    ['pos{s}_t{t:03d}.png']
    """
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(_NUMBER.sub("\0", name), []).append(name)
    found = []
    for members in groups.values():
        numbers = [_NUMBER.findall(name) for name in members]
        varies = [len({row[place] for row in numbers}) > 1 for place in range(len(numbers[0]))]
        found.append(_pattern_of(members, numbers, varies, fields))
    return sorted(found, key=lambda each: (-len(each.names), each.text))


def _pattern_of(
    members: Sequence[str], numbers: Sequence[list[str]], varies: Sequence[bool], fields: Sequence[str]
) -> GuessedPattern:
    """Return the pattern of names that differ in numbers only."""
    first, chosen, doubts = members[0], dict[int, str](), list[str]()
    spans = [each.span() for each in _NUMBER.finditer(first)]
    for place in range(len(spans)):
        # A minus before every number separates words.
        if all(row[place].startswith("-") for row in numbers):
            spans[place] = (spans[place][0] + 1, spans[place][1])
            for row in numbers:
                row[place] = row[place][1:]
    left = list(fields)
    open_places = [place for place, differs in enumerate(varies) if differs]
    for place in open_places:
        before = _LETTERS.search(first[: spans[place][0]])
        word = before[1].lower() if before else ""
        meaning = next((name for name in left if word in _MEANINGS[name]), None)
        if meaning is not None:
            chosen[place] = meaning
            left.remove(meaning)
    for place in open_places:
        if place not in chosen and left:
            # Without a word the last number counts frames, and the one before it positions.
            rest = [each for each in open_places if each not in chosen]
            order = [name for name in ("s", "t", *left) if name in left]
            meaning = order[0] if len(rest) > 1 or "t" not in order else "t"
            chosen[place] = meaning
            left.remove(meaning)
            doubts.append(meaning)
    text, end = "", 0
    for place, (start, stop) in enumerate(spans):
        text += first[end:start]
        if place not in chosen:
            text += "*" if varies[place] else first[start:stop]
        else:
            text += f"{{{chosen[place]}{_spec_of([row[place] for row in numbers])}}}"
        end = stop
    return GuessedPattern(text + first[end:], tuple(members), tuple(doubts))


def _spec_of(texts: Sequence[str]) -> str:
    """Return the format of integers that reproduces all their texts, preceded by a colon; empty if any form occurs."""
    widths = {len(text) for text in texts}
    signed = all(text[0] in "+-" for text in texts)
    specs = ["+d"] if signed else []
    specs += [f"+0{width}d" for width in widths] if signed else [f"0{width}d" for width in widths if width > 1]
    padded = any(text.lstrip("+-").startswith("0") and len(text.lstrip("+-")) > 1 for text in texts)
    if not signed and not padded:
        return ""
    return next((f":{spec}" for spec in specs if all(format(int(text), spec) == text for text in texts)), "")


def nearest_patterns(pattern: FilePattern, names: Sequence[str], most: int = 2) -> list[GuessedPattern]:
    """Return the patterns of a folder's names that are most like one that matches nothing."""
    guesses = guess_patterns(names, tuple(name for name in pattern.fields if name in INDEX_FIELDS))
    wanted = _FIELD.sub("0", pattern.text).lower()

    def likeness(guess: GuessedPattern) -> float:
        return difflib.SequenceMatcher(None, wanted, _FIELD.sub("0", guess.text).lower()).ratio()

    ranked = sorted(guesses[:_MOST_COMPARED], key=lambda guess: (-likeness(guess), -len(guess.names)))
    return [guess for guess in ranked if likeness(guess) > _LEAST_LIKE][:most]


_MOST_COMPARED, _LEAST_LIKE = 200, 0.4


def expected_indices(
    present: Collection[int], count: int | None, *, signed: bool = False, first: int | None = None
) -> tuple[list[int], str]:
    """Return the indices that files of ``count`` positions or frames should have, or why they are ambiguous.

    Indices run from ``first``; without it from 0 or 1 upwards, or, if they are ``signed``, symmetrically with 0 at the
    reference. Without a count they run from the smallest to the largest.

    >>> expected_indices({-1, 1, 2}, 5, signed=True)
    ([-2, -1, 0, 1, 2], '')
    >>> expected_indices({1, 2}, 3)[1]
    'run from 1 to 2, so that it is open whether the 3 run from 0 to 2 or from 1 to 3'
    """
    if not present:
        return [], "do not occur"
    low, high = min(present), max(present)
    if first is not None:
        last = high if count is None else first + count - 1
        outside = f"run from {low} to {high}, beyond {first} to {last}"
        return (list(range(first, last + 1)), "") if first <= low and high <= last else ([], outside)
    if count is None or high - low == count - 1:
        return list(range(low, high + 1)), ""
    if high - low >= count:
        return [], f"run from {low} to {high}, which are more than {count}"
    middle = (count - 1) // 2
    starts = [start for start in ((-middle,) if signed or low < 0 else (0, 1)) if start <= low and high < start + count]
    if len(starts) != 1:
        ranges = " or ".join(f"from {start} to {start + count - 1}" for start in starts or (0, 1, -middle))
        return [], f"run from {low} to {high}, so that it is open whether the {count} run {ranges}"
    return list(range(starts[0], starts[0] + count)), ""


def missing_names(
    pattern: FilePattern, expected: Mapping[str, Sequence[int]], files: Iterable[MatchedFile]
) -> list[str]:
    """Return the names that a pattern gives for the expected indices and that no file has, in order."""
    present = {each.index(*expected) for each in files}
    return [
        pattern.name(**dict(zip(expected, index, strict=True)))
        for index in product(*expected.values())
        if index not in present
    ]
