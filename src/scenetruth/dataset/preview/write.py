"""The preview of a recipe: a page with drawn values and thumbnails, before anything is rendered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.dataset.engine.in_order import in_order
from scenetruth.dataset.pages.charts import MOST_CHARTS, draw_histograms, draw_pairs, paired_of
from scenetruth.dataset.pages.contact_sheet import ON_A_SHEET, draw_contact_sheet, shown_grey
from scenetruth.dataset.pages.quantities import drawn_quantities
from scenetruth.dataset.pages.recipe_words import bound_words, ladder_rows, split_words, varied_rows
from scenetruth.dataset.pages.refusals import refusal_rows
from scenetruth.dataset.pages.writing import render_html
from scenetruth.dataset.preview.draws import Drawn, draw_some
from scenetruth.dataset.preview.thumbnails import SIMPLIFIED, thumbnail_of
from scenetruth.dataset.sampler import Draw, Sampler
from scenetruth.errors import Problem, RecipeError, SceneError
from scenetruth.placing import check_output, claim_folder, write_aside
from scenetruth.progress import Progress
from scenetruth.scene import scene_from_plain

__all__ = ["PAGE", "write_preview"]

PAGE = "preview.html"
_MOST_TOLD, _LONGEST = 20, 400
SHEET, VALUES, PAIRS = "contact_sheet.png", "values.png", "pairs.png"


def write_preview(
    sampler: Sampler,
    folder: str | Path,
    *,
    draws: int | None = None,
    overwrite: bool = False,
    workers: int = 0,
    progress: Progress | None = None,
) -> Path:
    """Draw some samples of a recipe, and show them: their values, their thumbnails, and why draws were refused.

    Nothing is rendered in full: thumbnails have simplified surfaces, and say so.

    Parameters
    ----------
    sampler
        The recipe with its base scenes.
    folder
        Where ``preview.html`` and its pictures go; it appears whole, or not at all.
    draws
        How many samples are drawn; if not given, 500, or 48 for recipes that bound the geometry.
    overwrite
        Whether an earlier preview may be replaced.
    workers
        Processes that look at the geometry and draw thumbnails; 0 for this one.
    progress
        Called with (what, done, total).

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    RecipeError
        If none of the samples can be drawn, or one of them makes no scene.
    OutputExistsError
        If the folder exists and may not be replaced.
    """
    claim = claim_folder(PAGE)
    check_output(folder, overwrite=overwrite, claim=claim)
    drawn = draw_some(sampler, draws, progress, workers)
    if not drawn.draws:
        raise RecipeError(drawn.trial.problems)
    with write_aside(folder, overwrite=overwrite, claim=claim) as aside:
        aside.mkdir()
        _draw_sheet(drawn.draws, aside / SHEET, workers, progress)
        content = _content(sampler, drawn, aside)
        (aside / PAGE).write_text(render_html("preview.html.j2", **content), encoding="utf-8")
    return Path(folder) / PAGE


def _content(sampler: Sampler, drawn: Drawn, folder: Path) -> dict[str, Any]:
    """Draw the charts, and return what the page shows."""
    recipe = sampler.recipe
    quantities = drawn_quantities(sampler, drawn.values())
    paired = paired_of(quantities)
    if quantities:
        draw_histograms(quantities, folder / VALUES)
    if paired:
        draw_pairs(paired, folder / PAIRS)
    splits = Counter(draw.split for draw in drawn.draws)
    return {
        "recipe": recipe,
        "bases": [str(base) for base in sampler.bases],
        "trial": drawn.trial,
        "problems": [f"{one}"[:_LONGEST] for one in drawn.trial.problems[:_MOST_TOLD]],
        "reasons": refusal_rows(drawn.trial.reasons),
        "shown": len(drawn.draws),
        "varied": varied_rows(sampler),
        "ladders": ladder_rows(sampler),
        "bounds": [bound_words(bound) for bound in recipe.accept],
        "splits": [(name, words, splits[name]) for name, words in split_words(sampler).items()],
        "sheet": SHEET,
        "simplified": SIMPLIFIED,
        "values": VALUES if quantities else "",
        "left_out": max(len(quantities) - MOST_CHARTS, 0),
        "pairs": PAIRS if paired else "",
    }


def _draw_sheet(draws: Sequence[Draw], path: Path, workers: int, progress: Progress | None) -> None:
    chosen = [draws[number * len(draws) // ON_A_SHEET] for number in range(ON_A_SHEET)]
    chosen = list({draw.number: draw for draw in chosen}.values())
    images: list[NDArray[np.float32]] = []
    found = in_order(_thumbnail, None, [draw.plain for draw in chosen], workers)
    for done, (draw, image) in enumerate(zip(chosen, found, strict=True)):
        if progress is not None:
            progress("thumbnails", done, len(chosen))
        if isinstance(image, SceneError):
            told = [Problem(one.path, f"{one.message} (in sample {draw.number})", one.value) for one in image.problems]
            raise RecipeError(told)
        images.append(image)
    if progress is not None:
        progress("thumbnails", len(chosen), len(chosen))
    captions = [f"{draw.number}" + (f" · {draw.split}" if draw.split else "") for draw in chosen]
    draw_contact_sheet(list(zip(captions, shown_grey(images), strict=True)), SIMPLIFIED, path)


def _thumbnail(_: None, plain: Mapping[str, Any]) -> NDArray[np.float32] | SceneError:
    try:
        return thumbnail_of(scene_from_plain(plain))
    except SceneError as error:
        return error
