"""Tests of tables as files."""

from __future__ import annotations

from pathlib import Path

from scenetruth.validation_studies.csv_tables import write_table


def test_columns_are_named_and_rows_keep_their_order(tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    write_table(file, [{"name": "σ, nominal", "value": 0.1, "bound": None}, {"name": "K", "value": 2, "bound": 1e-4}])
    assert file.read_text(encoding="utf-8").splitlines() == ["name,value,bound", '"σ, nominal",0.1,', "K,2,0.0001"]
