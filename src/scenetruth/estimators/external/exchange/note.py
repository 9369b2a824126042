"""The note beside results, results.json: which frames they hold, in which units, and who made them."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenetruth.errors import Problem
from scenetruth.estimators.external.exchange.result_files import NOTE_FILE, QUANTITIES
from scenetruth.plain import parse_json

__all__ = ["Note", "read_note"]

_LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3}
_KEYS = ("t", "method", "units")


@dataclass(frozen=True)
class Note:
    """What results.json says.

    Parameters
    ----------
    t
        The frames of arrays whose names do not say them; None if it does not say.
    method
        What to call the method; empty if it does not say.
    factors
        What to multiply quantities by, to have them in our units.
    """

    t: list[int] | None = None
    method: str = ""
    factors: Mapping[str, float] = field(default_factory=dict)


def read_note(folder: Path, frame_interval_s: float, problems: list[Problem]) -> Note:
    """Return what results.json says; nothing if it is not there.

    Parameters
    ----------
    folder
        The folder of results.
    frame_interval_s
        Time between two frames, for units per second.
    problems
        Where to note what is wrong.
    """
    file = folder / NOTE_FILE
    if not file.is_file():
        return Note()
    try:
        told = parse_json(file.read_bytes())
    except (ValueError, OSError) as error:
        problems.append(Problem(NOTE_FILE, f"cannot be read: {error}"))
        return Note()
    if not isinstance(told, dict):
        problems.append(Problem(NOTE_FILE, f"must be a mapping with any of {', '.join(_KEYS)}"))
        return Note()
    problems += [_unknown(key, key, _KEYS) for key in told if key not in _KEYS]
    t, method = told.get("t"), told.get("method", "")
    frames = None
    if t is not None:
        frames = t if isinstance(t, list) else [t]
        if not frames or not all(isinstance(n, int) and not isinstance(n, bool) for n in frames):
            problems.append(Problem(f"{NOTE_FILE}: t", "must be frame numbers: an integer, or a list of them", t))
            frames = None
        elif len(set(frames)) < len(frames):
            problems.append(Problem(f"{NOTE_FILE}: t", "names a frame twice", t))
            frames = None
    if not isinstance(method, str) or not method.isprintable():
        problems.append(Problem(f"{NOTE_FILE}: method", "must be a name", method))
        method = ""
    return Note(frames, method, _factors(told.get("units", {}), frame_interval_s, problems))


def _factors(units: Any, frame_interval_s: float, problems: list[Problem]) -> dict[str, float]:
    if not isinstance(units, dict):
        problems.append(Problem(f"{NOTE_FILE}: units", "must be a mapping from quantities to units", units))
        return {}
    found = {}
    for name, unit in units.items():
        if name not in QUANTITIES:
            problems.append(_unknown(f"units.{name}", name, tuple(QUANTITIES)))
            continue
        known = _units_of(name, frame_interval_s)
        if not isinstance(unit, str) or unit not in known:
            problems.append(Problem(f"{NOTE_FILE}: units.{name}", f"must be one of {', '.join(known)}", unit))
            continue
        found[name] = known[unit]
    return found


def _units_of(name: str, frame_interval_s: float) -> dict[str, float]:
    """Return the units that a quantity may have, the first one ours, with their factors."""
    what = name.removesuffix("_std")
    if what == "depth":
        return _LENGTHS
    if what in ("velocity", "depth_rate"):
        each = {f"{length}/frame": factor for length, factor in _LENGTHS.items()}
        return each | {f"{length}/s": factor * frame_interval_s for length, factor in _LENGTHS.items()}
    if what == "flow":
        return {"px/frame": 1.0, "px/s": frame_interval_s}
    return {"px/step": 1.0} if what == "disparity" else {"1": 1.0}


def _unknown(path: str, word: str, known: tuple[str, ...]) -> Problem:
    near = difflib.get_close_matches(word, known, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
    return Problem(f"{NOTE_FILE}: {path}", f"is unknown; {hint}")
