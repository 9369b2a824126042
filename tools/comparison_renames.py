"""Renamed names: one table (renames.yaml) that maps names of the checkout before to those of the checkout after."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice, product
from pathlib import Path
from typing import Any

__all__ = ["BETWEEN", "TABLE", "Renames", "name_of", "segments_of"]

TABLE = Path(__file__).parent / "renames.yaml"
BETWEEN = " / "
"""Between the segments of a key."""
_CANDIDATES = 500
_ALONE = ("commands", "options", "public names", "arguments")
"""Sections whose names mean nothing elsewhere."""


def segments_of(key: str) -> list[tuple[str, str]]:
    """Return the segments of a key as pairs of section and name; the section is empty for a plain segment."""
    return [_split(part) for part in key.split(BETWEEN)]


def _split(part: str) -> tuple[str, str]:
    section, colon, name = part.partition(":")
    return (section, name) if colon and section.replace(" ", "").isalpha() else ("", part)


def name_of(key: str) -> str:
    """Return the name in the last segment of a key that is not a number."""
    for _, name in reversed(segments_of(key)):
        if not name.isdigit():
            return name
    return key


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


class Renames:
    """The table of renamed names.

    A name is looked up in the section of its segment first, then in the other sections (but those of the interface).
    An entry ``PARENT/NAME`` holds only below a segment with the name PARENT, and precedes an entry ``NAME``. An entry
    applies only where the new name exists in the checkout after, so that the table may be ahead of the code.

    Parameters
    ----------
    table
        Section to old name to new name, or a list of new names; ``patterns`` are regular expressions to replacements,
        ``volatile`` and ``volatile_rows`` are lists of names, ``decided`` maps reasons to regular expressions.
    """

    def __init__(self, table: Mapping[str, Any]) -> None:
        lists = ("volatile", "volatile_rows", "patterns", "decided")
        self.patterns = [(re.compile(old), str(new)) for old, new in (table.get("patterns") or {}).items()]
        self.volatile = frozenset(map(str, table.get("volatile") or ()))
        self.volatile_rows = frozenset(map(str, table.get("volatile_rows") or ()))
        self._decided = {
            str(reason): [re.compile(one) for one in patterns]
            for reason, patterns in (table.get("decided") or {}).items()
        }
        self.sections: dict[str, dict[str, list[str]]] = {
            section: {str(old): [str(one) for one in _listed(new)] for old, new in (entries or {}).items()}
            for section, entries in table.items()
            if section not in lists
        }
        self.used: Counter[str] = Counter()

    @classmethod
    def read(cls, file: Path = TABLE) -> Renames:
        """Read a table."""
        import yaml

        return cls(yaml.safe_load(file.read_text(encoding="utf-8")) or {})

    @cached_property
    def _plain(self) -> frozenset[str]:
        """All old names without their parents."""
        return frozenset(old.rpartition("/")[2] for entries in self.sections.values() for old in entries)

    def names(self, section: str, name: str, parents: Sequence[str] = ()) -> list[str]:
        """Return what a name may be called in the checkout after: new names first, the name itself last.

        Parameters
        ----------
        section, name
            The section of the segment (empty for any) and the old name.
        parents
            Names of the segments before it.
        """
        found: list[str] = []
        if name in self._plain:
            order = [section, *(one for one in self.sections if one != section and one not in _ALONE)]
            for one in order:
                entries = self.sections.get(one, {})
                for old in (*(f"{parent}/{name}" for parent in reversed(parents)), name):
                    found += entries.get(old, [])
        patterned = name
        for pattern, new in self.patterns:
            patterned = pattern.sub(new, patterned)
        found += [patterned] if patterned != name else []
        for between in ("/", "."):
            parts = name.split(between)
            if len(parts) > 1:
                renamed = [self.names(section, part, (*parents, *parts[:place]))[0] for place, part in enumerate(parts)]
                found.append(between.join(renamed))
        return list(dict.fromkeys([*found, name]))

    def keys(self, key: str) -> Iterator[str]:
        """Give what a key may be called in the checkout after: new names first, the key itself last."""
        segments = segments_of(key)
        choices: list[list[str]] = []
        parents: list[str] = []
        for section, name in segments:
            choices.append([f"{section}:{one}" if section else one for one in self.names(section, name, parents)])
            parents.append(name)
        if all(len(one) == 1 for one in choices):
            yield key
            return
        yield from (BETWEEN.join(parts) for parts in islice(product(*choices), _CANDIDATES))
        yield key

    def volatile_name(self, names: Sequence[str]) -> str:
        """Return the first of the names of a key that is volatile, alone or below another one; empty if none is."""
        before: set[str] = set()
        for name in (part for one in names for part in one.split("/")):
            for one in (name, *(f"{parent}/{name}" for parent in before)):
                if one in self.volatile:
                    return one
            before.add(name)
        return ""

    def decided_change(self, line: str) -> str:
        """Return the reason of a difference that was decided on; empty if it is none of those."""
        return next((why for why, ones in self._decided.items() if any(one.search(line) for one in ones)), "")

    def unused(self) -> list[str]:
        """Return the entries that have mapped no key yet."""
        names = {name for key in +self.used for _, name in segments_of(key.partition(" -> ")[2])}
        new_names = names | {part for name in names for part in re.split("[/.]", name)}
        return [
            f"{section}: {old} -> {' or '.join(new)}"
            for section, entries in self.sections.items()
            for old, new in entries.items()
            if not new_names.intersection(new)
        ]

    def is_same(self, old: Any, new: Any, parents: Sequence[str] = ()) -> bool:
        """Return whether two values are equal, or an old name and its new name; NaN equals NaN."""
        if isinstance(old, str) and isinstance(new, str):
            if old == new:
                return True
            same = new in self.names("values", old, parents)
            self.used[f"{old} -> {new}"] += same
            return same
        if isinstance(old, list) and isinstance(new, list):
            return len(old) == len(new) and all(
                self.is_same(one, other, parents) for one, other in zip(old, new, strict=True)
            )
        if isinstance(old, dict) and isinstance(new, dict):
            renamed = {next((one for one in self.names("", key, parents) if one in new), key): key for key in old}
            return set(renamed) == set(new) and all(
                self.is_same(old[key], new[one], (*parents, key)) for one, key in renamed.items()
            )
        return type(old) is type(new) and (old == new or (old != old and new != new))

    def inputs(self, plain: Any, names: frozenset[str]) -> list[Any]:
        """Return how an input (a scene, a recipe, a goal) may be written for a checkout: the likeliest form first.

        Parameters
        ----------
        plain
            The input as plain values, in the names of the checkout before.
        names
            All names of fields and all words in the JSON Schema of the checkout.
        """
        forms = [self._input(plain, names, only=False), self._input(plain, names, only=True), plain]
        unique = {json.dumps(form, sort_keys=False, default=str): form for form in forms}
        return list(unique.values())

    def _input(self, value: Any, names: frozenset[str], *, only: bool, parents: tuple[str, ...] = ()) -> Any:
        if isinstance(value, Mapping):
            return {
                self._field(str(key), names, only, parents): self._input(
                    one, names, only=only, parents=(*parents, str(key))
                )
                for key, one in value.items()
            }
        if isinstance(value, list | tuple):
            return [self._input(one, names, only=only, parents=parents) for one in value]
        return self._word(value, names, only, parents, "values") if isinstance(value, str) else value

    def _field(self, path: str, names: frozenset[str], only: bool, parents: tuple[str, ...]) -> str:
        parts = path.split(".")
        return ".".join(
            self._word(part, names, only, (*parents, *parts[:place]), "fields") for place, part in enumerate(parts)
        )

    def _word(self, word: str, names: frozenset[str], only: bool, parents: tuple[str, ...], section: str) -> str:
        if only and word in names:
            return word
        entries = self.sections.get(section, {})
        for old in (*(f"{parent}/{word}" for parent in reversed(parents)), word):
            for new in entries.get(old, []):
                if new in names:
                    return new
        return word
