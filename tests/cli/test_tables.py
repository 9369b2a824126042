"""Tables fit the terminal, and lose no digits."""

from __future__ import annotations

import re

import pytest

from scenetruth.cli.console import print_main_figures
from scenetruth.scoring import Score

VALUES = {"rmse": 0.0123, "median_abs_error": 0.00456, "relative_rmse": 0.0789, "density": 0.918}


@pytest.mark.parametrize(("columns", "shares"), [(60, False), (72, True), (100, True)])
def test_main_figures_have_all_digits_however_narrow_the_terminal(
    columns: int, shares: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    several = dict.fromkeys(("depth", "velocity_x", "velocity_y", "velocity_z", "growth_rate_windowed"), VALUES)
    regions = {"all": several, "interior": several}
    print_main_figures(Score(regions), "refined")
    told = capsys.readouterr().out
    assert max(map(len, told.splitlines())) <= columns
    assert "…" not in told
    assert re.search(r"Velocity in Z\s+│\s+0\.0123 │\s+0\.00456 │ mm/frame", told)
    assert ("7.89 %" in told) is ("91.8 %" in told) is shares
