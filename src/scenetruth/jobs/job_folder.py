"""Output directories of resumable jobs: claimed by an index file, locked, and reused by the same job only."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenetruth.errors import ArgumentError, OutputExistsError, Problem
from scenetruth.output import check_writable, lock_output, remove_leftovers, write_atomically
from scenetruth.plain_data import parse_json

__all__ = ["JobFolder"]


@dataclass(frozen=True)
class JobFolder:
    """Output directory of one type of job.

    The index file is written when a job begins. It identifies the directory, and contains the fields that must be equal
    when the job is resumed.

    ``index``: Name of the index file. ``noun``: Type of job with its article, for messages: "a sweep". ``results``:
    Name of the subdirectory with the results of tasks. ``compared``: Fields of the index that must be equal when a job
    is resumed; None for all, empty for none. ``indent``: Indent of the index file.

    >>> from tempfile import TemporaryDirectory
    >>> folder = JobFolder("search.json", "a search", "points")
    >>> with TemporaryDirectory() as scratch:
    ...     with folder.open(f"{scratch}/new", {"seed": 1}) as place:
    ...         print(sorted(path.name for path in place.iterdir() if not path.name.startswith(".")))
    ['points', 'search.json']
    """

    index: str
    noun: str
    results: str
    compared: tuple[str, ...] | None = None
    indent: int | None = 1

    @contextmanager
    def open(
        self,
        output: str | Path | None,
        identity: Mapping[str, Any],
        *,
        other: str | Callable[[Any], str] = "contains another job; choose another directory",
        scheduler: str | None = None,
    ) -> Iterator[Path]:
        """Claim a directory and lock it while the block runs; remove incomplete output of killed processes."""
        if output is None:
            if scheduler is not None:
                message = "is missing; specify a directory that the workers of the scheduler reach by the same path"
                raise ArgumentError([Problem("output", message)])
            with tempfile.TemporaryDirectory(prefix="scenetruth-") as scratch:
                yield Path(scratch)
            return
        folder = Path(output)
        self._claim(folder, identity, other)
        with lock_output(folder / "run"):
            results = folder / self.results
            for each in (results, *(path for path in results.glob("*") if path.is_dir())):
                remove_leftovers(each)
            yield folder

    def _claim(self, folder: Path, identity: Mapping[str, Any], other: str | Callable[[Any], str]) -> None:
        index, wanted = folder / self.index, json.loads(json.dumps(identity))
        if index.exists():
            if self.compared == ():
                return
            try:
                there = parse_json(index.read_bytes())
            except (OSError, ValueError) as error:
                raise OutputExistsError(index, f"is damaged: {error}; choose another directory") from error
            if self._select(there) != self._select(wanted):
                raise OutputExistsError(folder, other if isinstance(other, str) else other(there))
            return
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise OutputExistsError(folder, f"exists, and is not a directory of {self.noun}; choose another")
        check_writable(folder)
        (folder / self.results).mkdir(parents=True, exist_ok=True)
        with write_atomically(index) as scratch:
            scratch.write_text(json.dumps(wanted, indent=self.indent, ensure_ascii=False) + "\n", encoding="utf-8")

    def _select(self, content: Any) -> Any:
        if self.compared is None or not isinstance(content, dict):
            return content
        return [content.get(name) for name in self.compared]
