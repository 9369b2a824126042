"""Bounded reading of YAML files, with the line of every problem."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenetruth.errors import CaptureError, Problem, RecipeError, SceneError
from scenetruth.input_files import describe_missing, regular_file_size
from scenetruth.plain_data import MAX_DEPTH, MAX_VALUES, scalar_problem

__all__ = ["MAX_YAML_BYTES", "NO_FILE", "InputProblemError", "read_file", "read_yaml"]

InputProblemError = type[SceneError] | type[RecipeError] | type[CaptureError]
"""Errors of input files."""

NO_FILE = "no such file"
"""Beginning of the message for a missing file."""

MAX_YAML_BYTES = 4_000_000
"""Maximum size of a scene or recipe file; bundled files have some thousand bytes."""

_LONGEST_WORD = 400
"""Length beyond which plain scalars are text, without the YAML rules for numbers and dates."""
_MAX_PROBLEMS = 50
_LEADING_ZEROS = re.compile(r"[+-]?0[0-9_]+")
_PREFIX = "tag:yaml.org,2002:"
_READ_AS = {"null": "null", "bool": "a boolean", "int": "an integer", "float": "a number"}


def read_file(file: str | Path, what: str, refused: InputProblemError) -> tuple[Any, Path]:
    """Return the values of a YAML file, and the base directory of its relative paths."""
    try:
        path = Path(file)
    except TypeError as error:
        raise refused([Problem("", "must be a file path", file)]) from error
    try:
        plain, problems = read_yaml(read_text(path, what))
        folder = path.parent.resolve()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise refused(
            [Problem("", describe_missing(path, f"{NO_FILE}; specify the path of {what}"))], source=path
        ) from error
    except (OSError, RuntimeError) as error:
        values = getattr(error, "strerror", None) or error
        raise refused([Problem("", f"cannot be read: {values}")], source=path) from error
    except ValueError as error:
        raise refused([Problem("", str(error))], source=path) from error
    if problems:
        raise refused(problems, source=path)
    return plain, folder


def read_text(file: Path, what: str = "a scene file") -> str:
    """Return the text of a YAML file."""
    try:
        size = regular_file_size(file)
    except ValueError as error:
        msg = f"{error}; specify the path of {what}"
        raise ValueError(msg) from error
    too_large = f"{what} has at most {MAX_YAML_BYTES:,}; check the path"
    if size > MAX_YAML_BYTES:
        msg = f"has {size:,} bytes; {too_large}"
        raise ValueError(msg)
    with file.open("rb") as stream:
        # The size of special files is not available in advance.
        content = stream.read(MAX_YAML_BYTES + 1)
    if len(content) > MAX_YAML_BYTES:
        msg = f"has more than {MAX_YAML_BYTES:,} bytes; {too_large}"
        raise ValueError(msg)
    if content[:2] in (b"\xff\xfe", b"\xfe\xff") or content[1:4:2] == b"\0\0":
        msg = "is UTF-16 or UTF-32; save it as UTF-8"
        raise ValueError(msg)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        msg = f"line {line}: is not UTF-8 (byte 0x{content[error.start]:02x}); save it as UTF-8"
        raise ValueError(msg) from error


def read_yaml(text: str) -> tuple[Any, list[Problem]]:
    r"""Return the values of a YAML text, and its problems.

    Numbers, words and merged keys are interpreted as by ``yaml.safe_load``. Rejected are duplicate and non-text keys,
    dates and other tags, numbers in base 60 or 8, numbers of more than 64 bits, recursive aliases, and more than
    `MAX_VALUES` values, counted with each use of an alias. Aliases are copied.

    >>> read_yaml("a: &size [1, 2.5]\nb: *size\nc: off")
    ({'a': [1, 2.5], 'b': [1, 2.5], 'c': False}, [])
    >>> print(*read_yaml("camera:\n  width: 3\n  width: 4")[1])
    camera.width: line 3: duplicate key, first defined in line 2; remove one of them
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    builder = _Builder()
    try:
        if re.search(r"^%TAG", text, re.MULTILINE):
            # Not needed, and the parser takes quadratic time for many of them.
            builder.refuse_all("the directive %TAG is not supported")
        for event in yaml.parse(text, Loader=loader):
            builder.take(event)
    except _EnoughError:
        pass
    except yaml.YAMLError as error:
        builder.problems.append(_syntax_problem(error, text))
    except (UnicodeError, RecursionError) as error:
        builder.problems.append(Problem("", f"is not valid YAML: {error}"))
    return builder.value, builder.problems


def _syntax_problem(error: Any, text: str) -> Problem:
    position = getattr(error, "position", None)
    if isinstance(position, int):
        line = text.count("\n", 0, position) + 1
        return Problem("", f'line {line}: is not valid YAML: contains a control character; escape it as in "\\x1b"')
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    words = " ".join(filter(None, (getattr(error, "context", None), getattr(error, "problem", None)))) or str(error)
    if "maximum nesting depth" in words and mark is not None:
        # Recent versions of the parser limit the look-ahead depth.
        return Problem("", f"line {mark.line + 1}: is nested more than {MAX_DEPTH} deep")
    where = "" if mark is None else f"line {mark.line + 1}, column {mark.column + 1}: "
    remedy = "" if mark is None else _remedy(words, text, mark.index, mark.column)
    return Problem("", f"{where}is not valid YAML: {' '.join(words.split())}{remedy}")


def _remedy(message: str, text: str, index: int, column: int) -> str:
    """Return a hint for common YAML mistakes, as the end of a message, or an empty string."""
    before, at = text[max(index - column, 0) : index], text[index : index + 1]
    if "\t" in (at, *before) and not (before + at).strip():
        return "; indent with spaces, not tabs"
    if "cannot start any token" in message:
        return f"; quote text that begins with {at}" if at.isprintable() else ""
    escapes = ("unknown escape character", "expected escape sequence", "hexdecimal", "hexadecimal")
    if any(words in message for words in escapes):
        return r"; in double quotes, \ begins a special character: use / in paths, or single quotes"
    if "mapping values are not allowed" in message:
        quoted = "quote text that contains a colon"
        # A line without a preceding colon is a key with too much indentation.
        return f"; {quoted}" if re.search(r":\s", before) else f"; align the line with its neighbours, or {quoted}"
    if "did not find expected" in message and not before.strip():
        return "; align lines of one block, and check for an unclosed quote or bracket in the line above"
    return ""


class _EnoughError(Exception):
    """Stop of the parsing."""


@dataclass
class _Anchored:
    """Anchored value, with its number of values and depth."""

    value: Any
    count: int
    height: int


@dataclass
class _Open:
    """Mapping or list under construction."""

    value: Any
    line: int
    anchor: str | None
    count: int = 1
    height: int = 1
    key: str | None = None
    """Key of the next value of a mapping; None if a key is expected."""
    merging: bool = False
    """Whether the next value is merged into the mapping."""
    lines: dict[str, int] = field(default_factory=dict)
    merged: dict[str, Any] = field(default_factory=dict)
    skipped: bool = False
    """Whether the next value belongs to a rejected key."""


class _Builder:
    """Non-recursive builder of values from parser events."""

    def __init__(self) -> None:
        import yaml

        self.value: Any = None
        self.problems: list[Problem] = []
        self._open: list[_Open] = []
        self._anchors: dict[str, _Anchored] = {}
        self._unfinished: set[str] = set()
        self._documents = 0
        self._total = 0
        self._resolver: Any = yaml.resolver.Resolver()
        self._constructor: Any = yaml.constructor.SafeConstructor()
        self._node = yaml.ScalarNode
        self._handlers: dict[type, Callable[[Any, int], None]] = {
            yaml.DocumentStartEvent: self._document,
            yaml.MappingStartEvent: lambda event, line: self._begin({}, event, line),
            yaml.SequenceStartEvent: lambda event, line: self._begin([], event, line),
            yaml.MappingEndEvent: self._end,
            yaml.SequenceEndEvent: self._end,
            yaml.AliasEvent: self._alias,
            yaml.ScalarEvent: self._scalar,
        }

    def take(self, event: Any) -> None:
        """Process one event."""
        handler = self._handlers.get(type(event))
        if handler is not None:
            handler(event, event.start_mark.line + 1)

    def _document(self, event: Any, line: int) -> None:
        self._documents += 1
        if self._documents > 1:
            self.refuse_all(f"line {line}: a second document starts (---); only one is supported")

    def refuse(self, message: str, line: int, value: Any = None, *, key: str | None = None) -> None:
        """Append a problem at the current position, or at a key of the open mapping."""
        path = [part for part in (self._get_item_key(item) for item in self._open) if part is not None]
        if key is not None:
            path = [part for part in (self._get_item_key(item) for item in self._open[:-1]) if part is not None] + [key]
        self.problems.append(Problem(".".join(path), f"line {line}: {message}", value))
        if len(self.problems) >= _MAX_PROBLEMS:
            raise _EnoughError

    def refuse_all(self, message: str) -> None:
        """Append a problem of the whole text, and stop."""
        self.problems.append(Problem("", message))
        raise _EnoughError

    @staticmethod
    def _get_item_key(item: _Open) -> str | None:
        return str(len(item.value)) if isinstance(item.value, list) else item.key

    def _begin(self, value: Any, event: Any, line: int) -> None:
        ordinary = _PREFIX + ("map" if isinstance(value, dict) else "seq")
        if event.tag not in (None, "!", ordinary):
            self.refuse(f"the tag {_format_tag(event.tag)} is not supported; remove it", line)
        if self._expects_key():
            self.refuse("a mapping or list cannot be a key", line)
            raise _EnoughError
        if len(self._open) == MAX_DEPTH:
            self.refuse_all(f"line {line}: is nested more than {MAX_DEPTH} deep")
        if event.anchor is not None:
            self._unfinished.add(event.anchor)
        self._open.append(_Open(value, line, event.anchor))

    def _end(self, event: Any, line: int) -> None:
        done = self._open.pop()
        if isinstance(done.value, dict):
            # Explicit keys take precedence over merged keys.
            done.value.update({key: value for key, value in done.merged.items() if key not in done.value})
        self._give(done.value, done.line, done.count, done.height, done.anchor)

    def _alias(self, event: Any, line: int) -> None:
        anchor = event.anchor
        if anchor in self._unfinished:
            self.refuse_all(f"line {line}: the alias *{anchor} is recursive")
        found = self._anchors.get(anchor)
        if found is None:
            self.refuse_all(f"line {line}: the alias *{anchor} has no preceding anchor")
            return
        if self._expects_key():
            if isinstance(found.value, str):
                self._take_key(found.value, line, merges=False)
                return
            self.refuse(f"the alias *{anchor} is not text and cannot be a key", line)
            raise _EnoughError
        if len(self._open) + found.height > MAX_DEPTH:
            self.refuse_all(f"line {line}: is nested more than {MAX_DEPTH} deep")
        self._count(found.count, line)
        self._give(copy.deepcopy(found.value), line, found.count, found.height, None, counted=True)

    def _scalar(self, event: Any, line: int) -> None:
        tag, plain = self._tag(event)
        if self._expects_key():
            if tag == "str" or (tag == "merge" and plain):
                self._take_key(event.value, line, merges=tag == "merge")
                if event.anchor is not None:
                    self._anchors[event.anchor] = _Anchored(event.value, 1, 0)
                return
            means = _READ_AS.get(tag, f"a {tag}")
            # In a flow mapping, a decimal comma ends the value.
            comma = "; a number has a decimal point, not a comma" if event.value.isdigit() else ""
            self.refuse(f"a key must be text, but YAML reads it as {means}: quote it{comma}", line, event.value)
            self._open[-1].key, self._open[-1].skipped = event.value, True
            return
        value, message = self._value(event.value, tag)
        if message:
            self.refuse(message, line, event.value)
        self._give(value, line, 1, 0, event.anchor)

    def _tag(self, event: Any) -> tuple[str, bool]:
        """Return the type of a scalar (end of its tag), and whether it is implied by its form only."""
        if event.tag in (None, "!"):
            if event.tag is None and event.implicit[0] and len(event.value) <= _LONGEST_WORD:
                tag = self._resolver.resolve(self._node, event.value, (True, False))
                return str(tag).removeprefix(_PREFIX), True
            return "str", False
        return event.tag.removeprefix(_PREFIX), False

    def _value(self, text: str, tag: str) -> tuple[Any, str]:
        if tag in ("str", "value", "merge"):
            return text, scalar_problem(text)
        if tag == "timestamp":
            return None, "YAML reads this as a date, which no field accepts: quote it if it is text"
        make = getattr(self._constructor, f"construct_yaml_{tag}", None) if tag in _READ_AS else None
        if tag in ("int", "float") and ":" in text:
            return None, "YAML reads this as a number in base 60: quote it if it is text, or write a single number"
        if tag == "int" and _LEADING_ZEROS.fullmatch(text):
            return None, "YAML reads numbers with leading zeros in base 8: remove them, or quote it if it is text"
        if make is None:
            return None, f"the tag {_format_tag(tag)} is not supported; remove it"
        try:
            value = make(self._node(_PREFIX + tag, text[: _LONGEST_WORD + 1]))
        except (ValueError, LookupError, ArithmeticError):
            return None, f"cannot be read as {_READ_AS[tag]}"
        return value, scalar_problem(value)

    def _expects_key(self) -> bool:
        return bool(self._open) and isinstance(self._open[-1].value, dict) and self._open[-1].key is None

    def _take_key(self, key: str, line: int, *, merges: bool) -> None:
        here = self._open[-1]
        here.key, here.merging = key, merges
        if merges:
            return
        message = scalar_problem(key)
        if message:
            here.key = None
            self.refuse(f"a key {message}", line, key)
            here.key = key
        elif key in here.lines:
            first = here.lines[key]
            self.refuse(f"duplicate key, first defined in line {first}; remove one of them", line, key=key)
        here.lines.setdefault(key, line)

    def _count(self, more: int, line: int) -> None:
        self._total += more
        if self._total > MAX_VALUES:
            message = f"line {line}: has more than {MAX_VALUES:,} values, with each use of an alias counted"
            self.refuse_all(message)

    def _give(
        self, value: Any, line: int, count: int, height: int, anchor: str | None, *, counted: bool = False
    ) -> None:
        if not counted:
            self._count(1, line)
        if anchor is not None:
            self._unfinished.discard(anchor)
            self._anchors[anchor] = _Anchored(value, count, height)
        if not self._open:
            self.value = value
            return
        here = self._open[-1]
        here.count += count
        here.height = max(here.height, height + 1)
        if isinstance(here.value, list):
            here.value.append(value)
            return
        key, here.key = here.key, None
        if here.merging:
            here.merging = False
            self._merge(value, line)
        elif here.skipped:
            here.skipped = False
        else:
            here.value[key] = value

    def _merge(self, value: Any, line: int) -> None:
        here = self._open[-1]
        given = value if isinstance(value, list) else [value]
        if not all(isinstance(item, dict) for item in given):
            self.refuse("<< merges mappings, but this is not a mapping", line, value)
            return
        for item in given:
            for key, entry in item.items():
                here.merged.setdefault(key, entry)


def _format_tag(tag: str) -> str:
    """Return a tag in file notation."""
    short = tag.removeprefix(_PREFIX)
    return short if short.startswith(("!", "tag:")) else f"!!{short}"
