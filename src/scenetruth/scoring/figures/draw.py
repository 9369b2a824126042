"""Drawing all figures of an estimate into a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import xarray as xr

from scenetruth.errors import Problem, ScoreError
from scenetruth.scoring.figures._common import FigureInfo, style
from scenetruth.scoring.figures._views import views_of
from scenetruth.scoring.figures.arrows import draw_velocity_arrows
from scenetruth.scoring.figures.confidence import draw_confidence
from scenetruth.scoring.figures.error_bars import draw_error_bars
from scenetruth.scoring.figures.growth import draw_growth, draw_growth_alone
from scenetruth.scoring.figures.histograms import draw_error_histograms
from scenetruth.scoring.figures.image import draw_image
from scenetruth.scoring.figures.maps import draw_depth, draw_disparity, draw_flow
from scenetruth.scoring.figures.surface import draw_surface
from scenetruth.scoring.figures.velocity import draw_velocity_z, draw_velocity_z_row
from scenetruth.scoring.score import Score

__all__ = ["draw_all"]


def draw_all(
    recording: xr.Dataset,
    estimate: xr.Dataset,
    truth: xr.Dataset | None = None,
    score: Score | None = None,
    folder: str | Path = ".",
    progress: Callable[[str, int, int], None] | None = None,
) -> list[FigureInfo]:
    """Draw every figure of an estimate.

    All but the histograms show one frame, t = 0 or, where the estimate lacks it, its middle one; and of the estimate
    only what is full (see `full_pixels`).

    Parameters
    ----------
    recording
        The recording, for its image at s = 0.
    estimate
        The estimate.
    truth, score
        What the estimate was compared with, and its score; both or neither. Without them, the figures show the estimate
        alone: no errors, no histograms of them.
    folder
        Where the PNG files go; made if missing.
    progress
        Called as ``progress("report", done, total)``, in figures.

    Returns
    -------
    list of FigureInfo
        File names inside the folder, titles and captions, in reading order. Figures of what the estimate does not know
        are left out: those of depth and of velocity, as by one camera or one frame; ``disparity.png`` and ``flow.png``
        are there where disparity is known but depth is not, and flow but velocity is not. Further ``error_bars.png``
        for an estimate without standard deviations, ``growth_rate.png`` where the truth says that nothing grows, and
        ``confidence.png`` for an estimate that has neither ``confidence`` nor kinds nor ``model_violation``.

    Raises
    ------
    ScoreError
        If recording, estimate and truth do not belong together, or there is a truth without a score or a score without
        a truth; lists what is wrong.
    """
    check_truth_and_score(truth, score)
    target = Path(folder)
    views = views_of(recording, estimate, truth)
    target.mkdir(parents=True, exist_ok=True)
    depth, velocity = views.knows("depth"), views.knows("velocity_z")
    plan: list[tuple[bool, Callable[[], FigureInfo | None]]] = [
        (True, lambda: draw_image(views, target)),
        (depth, lambda: draw_surface(views, target)),
        (velocity, lambda: draw_velocity_z(views, target)),
        (velocity, lambda: draw_velocity_z_row(views, target)),
        (depth and velocity, lambda: draw_velocity_arrows(views, target)),
        (views.knows("flow_x") and not velocity, lambda: draw_flow(views, target)),
        (depth, lambda: draw_depth(views, target)),
        (views.knows("disparity") and not depth, lambda: draw_disparity(views, target)),
    ]
    if truth is None or score is None:
        plan.append((depth and velocity, lambda: draw_growth_alone(views, estimate, target)))
    else:
        plan += [
            (depth and velocity and score.grows, lambda: draw_growth(views, estimate, truth, score, target)),
            (True, lambda: draw_error_histograms(estimate, truth, score, target)),
        ]
    plan += [
        (True, lambda: draw_error_bars(views, estimate, truth, score, target)),
        (True, lambda: draw_confidence(views, target)),
    ]
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


def check_truth_and_score(truth: xr.Dataset | None, score: Score | None) -> None:
    """Check that there are both a truth and its score, or neither.

    Raises
    ------
    ScoreError
        If one of them is missing.
    """
    if truth is not None and score is None:
        raise ScoreError([Problem("score", "is missing; make it with scenetruth.score(estimate, truth, recording)")])
    if truth is None and score is not None:
        raise ScoreError([Problem("truth", "is missing; a score is shown with the truth that it was made with")])
