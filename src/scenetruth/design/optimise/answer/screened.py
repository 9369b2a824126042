"""The table of all predictions in a file of comma separated values, and back."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["read_screened", "write_screened"]

_WORDS = ("phase", "problem")


def write_screened(table: pd.DataFrame, file: Path) -> None:
    """Write all predictions; values that are neither numbers nor texts are written as JSON.

    Parameters
    ----------
    table
        The predictions.
    file
        The file, which is overwritten.
    """
    told = table.copy()
    for name in told.columns:
        if told[name].dtype == object and name not in _WORDS:
            told[name] = [_text(value) for value in told[name]]
    told.to_csv(file, index=False)


def read_screened(file: Path, free: Mapping[str, Any]) -> pd.DataFrame:
    """Return all predictions of a file.

    Parameters
    ----------
    file
        The file.
    free
        What is free in the goal, as plain values: which choices texts stand for.
    """
    import pandas as pd

    table = pd.read_csv(file, dtype=str, keep_default_na=False)
    found = {}
    for name in table.columns:
        choices = {_text(value): value for value in _choices(free.get(name))}
        is_text = name in _WORDS or (name in free and not _is_range(free[name]))
        found[name] = [choices.get(text, text) if is_text else _number(text) for text in table[name]]
    return pd.DataFrame(found)


def _choices(free: Any) -> list[Any]:
    values = free.get("values") if isinstance(free, Mapping) else free
    return list(values) if isinstance(values, list | tuple) else []


def _text(value: Any) -> str:
    is_plain = isinstance(value, str) or (isinstance(value, int | float) and not isinstance(value, bool))
    return str(value) if is_plain else json.dumps(value, ensure_ascii=False)


def _is_range(free: Any) -> bool:
    return isinstance(free, Mapping) and free.get("from") is not None


def _number(text: str) -> float | int | bool:
    if text in ("True", "False"):
        return text == "True"
    try:
        return int(text)
    except ValueError:
        return float(text or "nan")
