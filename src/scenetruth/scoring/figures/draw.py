"""Drawing all figures of a scored estimate into a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import xarray as xr

from scenetruth.scoring.figures._common import FigureInfo, style
from scenetruth.scoring.figures._views import views_of
from scenetruth.scoring.figures.arrows import draw_velocity_arrows
from scenetruth.scoring.figures.confidence import draw_confidence
from scenetruth.scoring.figures.depth import draw_depth
from scenetruth.scoring.figures.error_bars import draw_error_bars
from scenetruth.scoring.figures.growth import draw_growth
from scenetruth.scoring.figures.histograms import draw_error_histograms
from scenetruth.scoring.figures.image import draw_image
from scenetruth.scoring.figures.surface import draw_surface
from scenetruth.scoring.figures.velocity import draw_velocity_z, draw_velocity_z_row
from scenetruth.scoring.score import Score

__all__ = ["draw_all"]


def draw_all(
    recording: xr.Dataset,
    estimate: xr.Dataset,
    truth: xr.Dataset,
    score: Score,
    folder: str | Path,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[FigureInfo]:
    """Draw every figure of a scored estimate.

    All but the histograms show one frame, t = 0 or, where the estimate lacks it, its middle one; and of the estimate
    only what is full (see `full_pixels`).

    Parameters
    ----------
    recording
        The recording, for its image at s = 0.
    estimate, truth
        What was scored.
    score
        Their score.
    folder
        Where the PNG files go; made if missing.
    progress
        Called as ``progress("report", done, total)``, in figures.

    Returns
    -------
    list of FigureInfo
        File names inside the folder, titles and captions, in reading order. The figures of depth and of velocity are
        left out where none is known, as by one camera or one frame, ``error_bars.png`` for an estimate without
        standard deviations of either, ``growth_rate.png`` where nothing grows, and ``confidence.png`` for
        an estimate that has neither ``confidence`` nor kinds nor ``model_violation``.

    Raises
    ------
    ScoreError
        If recording, estimate and truth do not belong together; lists what is wrong.
    """
    target = Path(folder)
    views = views_of(recording, estimate, truth)
    target.mkdir(parents=True, exist_ok=True)
    depth, velocity = views.knows("depth"), views.knows("velocity_z")
    plan: tuple[tuple[bool, Callable[[], FigureInfo | None]], ...] = (
        (True, lambda: draw_image(views, target)),
        (depth, lambda: draw_surface(views, target)),
        (velocity, lambda: draw_velocity_z(views, target)),
        (velocity, lambda: draw_velocity_z_row(views, target)),
        (velocity, lambda: draw_velocity_arrows(views, target)),
        (depth, lambda: draw_depth(views, target)),
        (velocity and score.grows, lambda: draw_growth(views, estimate, truth, score, target)),
        (True, lambda: draw_error_histograms(estimate, truth, score, target)),
        (True, lambda: draw_error_bars(views, estimate, truth, score, target)),
        (True, lambda: draw_confidence(views, target)),
    )
    steps = [draw for wanted, draw in plan if wanted]
    figures: list[FigureInfo] = []
    for done, draw in enumerate(steps):
        if progress is not None:
            progress("report", done, len(steps))
        with style():
            figure = draw()
        if figure is not None:
            figures.append(figure)
    if progress is not None:
        progress("report", len(steps), len(steps))
    return figures
