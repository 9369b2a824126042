"""Tables of results as CSV files."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["write_table"]


def write_table(file: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a table as CSV in UTF-8 with a header."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
