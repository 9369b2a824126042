"""Catalogues from files: entries by name, every problem told at once."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from scenetruth.design.optimise.catalogues.entries import CameraEntry, Catalogue, Entry, LensEntry, StageEntry
from scenetruth.design.optimise.problems import GoalError
from scenetruth.errors import Problem
from scenetruth.scene.reading import read_file

__all__ = ["Entries", "catalogue_problems", "load_catalogues"]

_BUNDLED = Path(__file__).with_name("bundled.yaml")
_MODELS: Mapping[str, type[Entry]] = {"lenses": LensEntry, "cameras": CameraEntry, "stages": StageEntry}


@dataclass(frozen=True)
class Entries:
    """All entries that there are, by name.

    Parameters
    ----------
    lenses, cameras, stages
        Of each kind.
    """

    lenses: Mapping[str, LensEntry]
    cameras: Mapping[str, CameraEntry]
    stages: Mapping[str, StageEntry]

    def of(self, kind: str) -> Mapping[str, Entry]:
        """Return the entries that a parameter ``lens``, ``camera`` or ``stage`` chooses from."""
        return {"lens": self.lenses, "camera": self.cameras, "stage": self.stages}[kind]


def load_catalogues(files: Sequence[str | Path] = ()) -> Entries:
    """Return the entries that ship, and those of files.

    Parameters
    ----------
    files
        Files in YAML with ``lenses``, ``cameras`` and ``stages``; an entry replaces an earlier one of its name.

    Raises
    ------
    GoalError
        With every problem of every file: fields without units, unknown fields, what is missing.
    """
    found = [_bundled()]
    problems: list[Problem] = []
    for file in files:
        try:
            plain, _ = read_file(file, "a catalogue", GoalError)
            found.append(_catalogue(plain, str(file)))
        except GoalError as error:
            here = [(f"{file}: {one.path or '(top level)'}", one) for one in error.problems]
            problems += [Problem(path, one.message, one.value) for path, one in here]
    if problems:
        raise GoalError(problems)
    lenses: dict[str, LensEntry] = {}
    cameras: dict[str, CameraEntry] = {}
    stages: dict[str, StageEntry] = {}
    for one in found:
        lenses |= one.lenses
        cameras |= one.cameras
        stages |= one.stages
    return Entries(lenses, cameras, stages)


@cache
def _bundled() -> Catalogue:
    plain, _ = read_file(_BUNDLED, "a catalogue", GoalError)
    return _catalogue(plain, str(_BUNDLED))


def _catalogue(plain: Any, source: str) -> Catalogue:
    if not isinstance(plain, dict):
        raise GoalError([Problem("", "must be a mapping of lenses, cameras and stages", plain)], source=source)
    try:
        return Catalogue.model_validate(plain)
    except ValidationError as error:
        raise GoalError(catalogue_problems(error), source=source) from error


def catalogue_problems(error: ValidationError) -> list[Problem]:
    """Return what is wrong with a catalogue; of a field without its unit, which one is meant."""
    found = []
    for entry in error.errors(include_url=False):
        where = [str(key) for key in entry["loc"]]
        message = str(entry["msg"]).removeprefix("Value error, ")
        if entry["type"] == "extra_forbidden":
            model = _MODELS.get(where[0]) if len(where) > 2 else None
            message = _unknown(where[-1], list(model.model_fields) if model else list(Catalogue.model_fields))
        elif entry["type"] == "missing":
            message = "is missing"
        value = None if entry["type"] == "missing" or len(where) < 3 else entry.get("input")
        found.append(Problem(".".join(where), message[:1].lower() + message[1:], value))
    return found


def _unknown(key: str, known: Sequence[str]) -> str:
    with_unit = [name for name in known if name.startswith(f"{key}_")]
    if with_unit:
        return f"has no unit in its name: write {' or '.join(with_unit)}"
    near = difflib.get_close_matches(key, known, n=1)
    return f"unknown key; did you mean '{near[0]}'?" if near else f"unknown key; known here: {', '.join(known)}"
