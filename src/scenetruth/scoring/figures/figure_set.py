"""The set of all figures of an estimate, and their output to a directory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from concurrent.futures import Future
from pathlib import Path

import xarray as xr

from scenetruth.errors import Problem, ScoreError
from scenetruth.scoring.figures.error_figures import draw_error_bars, draw_error_histograms
from scenetruth.scoring.figures.figure_arrays import collect_figure_arrays
from scenetruth.scoring.figures.figure_style import VECTOR_FORMATS, FigureInfo, also_as, style
from scenetruth.scoring.figures.map_figures import (
    draw_coherence,
    draw_depth,
    draw_disparity,
    draw_estimated_growth,
    draw_flow,
    draw_growth,
    draw_image,
    draw_velocity_z,
    draw_velocity_z_row,
)
from scenetruth.scoring.figures.surface_figures import draw_surface, draw_velocity_arrows
from scenetruth.scoring.score_result import Score, includes_fallback

__all__ = ["FIGURES", "plot_all", "plot_one"]

_AHEAD = 2  # figures that another process is asked for together, so that it is never without work

Draw = Callable[[], FigureInfo | None]

FIGURES = (
    "image",
    "surface",
    "velocity_z",
    "velocity_z_row",
    "velocity_arrows",
    "flow",
    "depth",
    "disparity",
    "growth_rate",
    "error_histograms",
    "error_bars",
    "coherence",
)
"""Names of all figures and of their files, in reading order."""


def plot_all(
    recording: xr.Dataset,
    estimate: xr.Dataset,
    truth: xr.Dataset | None = None,
    score: Score | None = None,
    folder: str | Path = ".",
    progress: Callable[[str, int, int], None] | None = None,
    *,
    names: Collection[str] | None = None,
    elsewhere: Callable[[str], Future[FigureInfo | None]] | None = None,
    meanwhile: Callable[[], None] = lambda: None,
    also: Collection[str] = (),
) -> list[FigureInfo]:
    """Draw every figure; all except the histograms show the valid pixels of one frame, t = 0 or the middle one.

    ``elsewhere``: Ask another process for a figure; if that fails, the figure is drawn here.
    ``meanwhile``: Other work of this process, done while the other draws its first figures.
    """
    check_truth_and_score(truth, score)
    target = Path(folder)
    plan = _plan(recording, estimate, truth, score, target)
    problems = [
        Problem(what, f"unknown; available: {', '.join(known)}", sorted(unknown))
        for what, wanted, known in (("figures", names or (), FIGURES), ("formats", also, VECTOR_FORMATS))
        if (unknown := set(wanted) - set(known))
    ]
    if problems:
        raise ScoreError(problems)
    if also:
        elsewhere = None
    target.mkdir(parents=True, exist_ok=True)
    left = deque(name for name in plan if names is None or name in names)
    total, done, shown = len(left), 0, -1
    found: dict[str, FigureInfo | None] = {}
    away: deque[tuple[str, Future[FigureInfo | None]]] = deque()
    started = False
    while left or away or not started:
        if progress is not None and done > shown:
            progress("report", done, total)
            shown = done
        if elsewhere is not None and len(away) < _AHEAD and len(left) > 1:
            name = left.pop()
            away.append((name, elsewhere(name)))
        elif not started:
            meanwhile()
            started = True
        elif not left and away[-1][1].cancel():
            left.append(away.pop()[0])
        elif away and (away[0][1].done() or not left):
            name, asked = away.popleft()
            if asked.exception() is None:
                found[name] = asked.result()
                done += 1
            else:
                # Drawing it again in this process raises the error here.
                left.append(name)
                elsewhere = None
        else:
            name = left.popleft()
            with style(), also_as(also):
                found[name] = plan[name]()
            done += 1
    if progress is not None:
        progress("report", total, total)
    drawn = [found[name] for name in plan if name in found]
    return [figure for figure in drawn if figure is not None]


def plot_one(
    name: str,
    recording: xr.Dataset,
    estimate: xr.Dataset,
    truth: xr.Dataset | None,
    score: Score | None,
    folder: str | Path,
) -> FigureInfo | None:
    """Draw one figure into an existing directory; None if the estimate lacks its data."""
    plan = _plan(recording, estimate, truth, score, Path(folder))
    if name not in plan:
        return None
    with style():
        return plan[name]()


def _plan(
    recording: xr.Dataset, estimate: xr.Dataset, truth: xr.Dataset | None, score: Score | None, target: Path
) -> dict[str, Draw]:
    """Return the figures that the data of the estimate allow, in reading order."""
    include_fallback = score is not None and includes_fallback(score)
    views = collect_figure_arrays(recording, estimate, truth, include_fallback=include_fallback)
    depth, velocity = views.knows("depth"), views.knows("velocity_z")
    growth = (depth and velocity) or views.knows("growth_rate")
    plan: list[tuple[str, bool, Draw]] = [
        ("image", True, lambda: draw_image(views, target)),
        ("surface", depth, lambda: draw_surface(views, target)),
        ("velocity_z", velocity, lambda: draw_velocity_z(views, target)),
        ("velocity_z_row", velocity, lambda: draw_velocity_z_row(views, target)),
        ("velocity_arrows", depth and velocity, lambda: draw_velocity_arrows(views, target)),
        ("flow", views.knows("flow_x") and not velocity, lambda: draw_flow(views, target)),
        ("depth", depth, lambda: draw_depth(views, target)),
        ("disparity", views.knows("disparity") and not depth, lambda: draw_disparity(views, target)),
    ]
    if truth is None or score is None:
        plan.append(("growth_rate", growth, lambda: draw_estimated_growth(views, estimate, target)))
    else:
        plan += [
            ("growth_rate", growth and score.grows, lambda: draw_growth(views, estimate, truth, score, target)),
            ("error_histograms", True, lambda: draw_error_histograms(estimate, truth, score, target)),
        ]
    plan += [
        ("error_bars", True, lambda: draw_error_bars(views, estimate, truth, score, target)),
        ("coherence", True, lambda: draw_coherence(views, target)),
    ]
    return {name: draw for name, wanted, draw in plan if wanted}


def check_truth_and_score(truth: xr.Dataset | None, score: Score | None) -> None:
    """Check that truth and score are either both given or both missing."""
    if truth is not None and score is None:
        raise ScoreError([Problem("score", "is missing; compute it with scenetruth.score(estimate, truth, recording)")])
    if truth is None and score is not None:
        raise ScoreError([Problem("truth", "is missing; a score is shown with the truth from which it was computed")])
