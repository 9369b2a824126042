"""Fixtures of the tests of scores; figures take seconds to draw, so that tests share them."""

from __future__ import annotations

import matplotlib
import pytest

from scenetruth.scoring import plot_all, score
from tests.helpers.synthetic_case import Case, Drawn, make_case, with_error_bars


@pytest.fixture(scope="session")
def case() -> Case:
    return make_case()


@pytest.fixture(scope="session")
def full_case(case: Case) -> Case:
    return with_error_bars(case)


@pytest.fixture(scope="session")
def small_case() -> Case:
    """A quarter of the pixels: the surface of `full_case` takes more time to draw than the other eight figures."""
    return with_error_bars(make_case(80, 60, 620.0))


@pytest.fixture(scope="session")
def drawn(small_case: Case, tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    folder = tmp_path_factory.mktemp("figures") / "new"
    calls: list[tuple[str, int, int]] = []
    before = dict(matplotlib.rcParams)
    case, result = small_case, score(small_case.estimate, small_case.truth)
    figures = plot_all(case.recording, case.estimate, case.truth, result, folder, lambda *call: calls.append(call))
    return Drawn(folder, figures, calls, dict(matplotlib.rcParams) == before)
