"""Commands as they are written down: words with places for folders."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Mapping
from pathlib import Path

__all__ = ["PLACES", "files_of", "filled", "program_problem", "words_of"]

PLACES = ("recording", "output")
"""What must stand in braces in a command, each at least once."""

_BRACES = re.compile(r"\{\{|\}\}|\{([^{}]*)\}")


def words_of(command: str) -> list[str]:
    """Return the words of a command, as a shell would split them; nothing in them is expanded.

    Raises
    ------
    ValueError
        If it has no words, quotes that do not end, places that are unknown, or not all of `PLACES`.

    Examples
    --------
    >>> words_of("python 'my program.py' {recording} --to={output}")
    ['python', 'my program.py', '{recording}', '--to={output}']
    >>> words_of("mine {recordings} {output}")
    Traceback (most recent call last):
    ValueError: {recordings} is unknown, did you mean {recording}?; {recording} is missing
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        msg = f"cannot be split into words: {error}"
        raise ValueError(msg) from error
    places = [match[1] for word in words for match in _BRACES.finditer(word) if match[1] is not None]
    wrong = []
    for place in dict.fromkeys(places):
        if place not in PLACES:
            near = difflib.get_close_matches(place, PLACES, n=1)
            hint = f"did you mean {{{near[0]}}}?" if near else "known: {recording}, {output}; other braces are doubled"
            wrong.append(f"{{{place}}} is unknown, {hint}")
    wrong += [f"{{{place}}} is missing" for place in PLACES if place not in places]
    if wrong:
        raise ValueError("; ".join(wrong))
    return words


def filled(words: list[str], folders: Mapping[str, Path], base: Path) -> list[str]:
    """Return words with folders in their places.

    Programs run in a folder of their own. Words without a place that name a file below ``base`` become absolute, so
    that ``python mine.py`` finds what it found there.

    Parameters
    ----------
    words
        From `words_of`.
    folders
        A folder for each of `PLACES`.
    base
        The folder that relative names of files count from.
    """
    return [_filled(word, folders, base) for word in words]


def _filled(word: str, folders: Mapping[str, Path], base: Path) -> str:
    def one(match: re.Match[str]) -> str:
        place: str | None = match[1]
        return match[0][0] if place is None else str(folders[place])

    if not any(match[1] is not None for match in _BRACES.finditer(word)):
        try:
            if word and (base / word).is_file():
                return str(base / word)
        except (OSError, ValueError):  # a word that no file can be named like
            pass
    return _BRACES.sub(one, word)


def files_of(words: list[str], base: Path) -> list[Path]:
    """Return the files that words name, also after ``--option=``, and the program, wherever it is found.

    Parameters
    ----------
    words
        From `words_of`.
    base
        The folder that relative names of files count from.
    """
    import shutil

    named = [part for word in words for part in (word, word.partition("=")[2]) if part]
    found = [] if (base / words[0]).is_file() else [Path(shutil.which(words[0]) or base)]
    for name in named:
        try:
            found += [base / name] if (base / name).is_file() else []
        except (OSError, ValueError):  # a word that no file can be named like
            continue
    return [path for path in found if path.is_file()]


def program_problem(word: str, base: Path) -> str:
    """Return why a program cannot be started; empty if it can, as far as can be told."""
    import os
    import shutil

    if (base / word).is_file() and not os.access(base / word, os.X_OK):
        return "may not be executed: name its interpreter before it, or allow it (chmod +x)"
    if (base / word).is_file() or shutil.which(word) is not None:
        return ""
    return "there is no such program"
