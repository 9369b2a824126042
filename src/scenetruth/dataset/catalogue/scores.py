"""Scores of methods as columns of the catalogue: one row per sample, one table per method."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.dataset.folder import DatasetFolder
from scenetruth.errors import StoreError
from scenetruth.placing import write_aside
from scenetruth.plain import parse_json
from scenetruth.scoring import Score

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["columns_of", "score_file", "scores_of", "write_scores"]

_REGIONS = ("all", "interior")
_STATISTICS = ("bias", "rms", "median_abs", "density", "calibration", "within_2_std", "count")


def columns_of(score: Score) -> dict[str, Any]:
    """Return a score as columns: ``interior.depth.rms``, and so on."""
    return {
        f"{region}.{quantity}.{name}": found.get(name)
        for region in _REGIONS
        for quantity, found in score.regions.get(region, {}).items()
        for name in _STATISTICS
        if name in found
    }


def score_file(folder: DatasetFolder, method: str, number: int) -> Path:
    """Return the file that holds the score of one sample."""
    return folder.scores(method) / f"{number // 1000:05d}" / f"{number:08d}.json"


def write_scores(folder: DatasetFolder, method: str) -> None:
    """Put the scores of all samples into one table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = []
    for path in sorted(folder.scores(method).glob("*/*.json")):
        if not re.fullmatch(r"[0-9]{8}", path.stem):
            continue
        try:
            rows.append(dict(parse_json(path.read_bytes())))
        except (OSError, ValueError, TypeError) as error:
            raise StoreError(path, f"is damaged: {error}; remove it, and estimate again") from error
    if not rows:
        return
    names = list(dict.fromkeys(name for row in rows for name in row))
    schema = pa.schema([(name, pa.int64() if name == "sample" else pa.float64()) for name in names])
    with write_aside(folder.scores_table(method), overwrite=True) as aside:
        pq.write_table(pa.Table.from_pylist(rows, schema=schema), aside, compression="zstd")


def scores_of(folder: DatasetFolder) -> dict[str, pd.DataFrame]:
    """Return the tables of all methods, by the method's name, with ``sample`` as index."""
    import pandas as pd

    return {
        name: pd.read_parquet(folder.scores_table(name)).set_index("sample")
        for name in folder.scored()
        if folder.scores_table(name).exists()
    }
