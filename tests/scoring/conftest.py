"""Fixtures of the tests of scores; figures take seconds to draw, so that tests share them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import pytest

from scenetruth.scoring import FigureInfo, plot_all, score
from tests.scoring.synthetic import Case, make_case, with_error_bars


@dataclass(frozen=True)
class Drawn:
    """The figures of the case, and what happened while they were drawn."""

    folder: Path
    figures: list[FigureInfo]
    calls: list[tuple[str, int, int]]
    settings_kept: bool


@pytest.fixture(scope="session")
def case() -> Case:
    return make_case()


@pytest.fixture(scope="session")
def full_case(case: Case) -> Case:
    return with_error_bars(case)


@pytest.fixture(scope="session")
def drawn(full_case: Case, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    folder = tmp_path_factory.mktemp("figures") / "new"
    calls: list[tuple[str, int, int]] = []
    before = dict(matplotlib.rcParams)
    case, result = full_case, score(full_case.estimate, full_case.truth)
    figures = plot_all(case.recording, case.estimate, case.truth, result, folder, lambda *call: calls.append(call))
    return Drawn(folder, figures, calls, dict(matplotlib.rcParams) == before)
