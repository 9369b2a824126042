"""What the card of a data set tells, found in its folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenetruth.dataset.card.columns import VALUE
from scenetruth.dataset.card.images import small_images
from scenetruth.dataset.catalogue.statistics import STATISTICS
from scenetruth.dataset.folder import DatasetFolder
from scenetruth.dataset.identity import Identity
from scenetruth.dataset.pages.charts import MOST_CHARTS, draw_histograms, draw_pairs, paired_of
from scenetruth.dataset.pages.contact_sheet import ON_A_SHEET, draw_contact_sheet, shown_grey
from scenetruth.dataset.pages.labels import split_unit
from scenetruth.dataset.pages.quantities import Quantity, drawn_quantities
from scenetruth.dataset.pages.recipe_words import bound_words, ladder_rows, split_words, varied_rows
from scenetruth.dataset.pages.refusals import refusal_rows
from scenetruth.dataset.pages.writing import size_words
from scenetruth.dataset.preview.draws import some_numbers
from scenetruth.dataset.sampler import Sampler
from scenetruth.plain import parse_json
from scenetruth.progress import Progress
from scenetruth.scoring._format import format_count, format_number

if TYPE_CHECKING:
    import pyarrow

__all__ = ["card_contents"]

SHEET, VALUES, PAIRS, STATED = "contact_sheet.png", "values.png", "pairs.png", "statistics.png"
_IMAGES = "Images of the reference camera (s = 0) at t = 0, made smaller, all on one scale of grey."
_MOST_WARNINGS = 10


def card_contents(
    folder: DatasetFolder,
    sampler: Sampler,
    identity: Identity,
    table: pyarrow.Table,
    pictures: Path,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Draw the pictures of a card, and return what its templates show.

    Parameters
    ----------
    folder, sampler, identity
        The data set.
    table
        Its catalogue.
    pictures
        Where pictures go, a folder that exists.
    progress
        Called with (what, done, total).
    """
    recipe = sampler.recipe
    quantities = drawn_quantities(sampler, _values_of(table))
    paired = paired_of(quantities)
    statistics = [_statistic(name, table[name].to_pylist()) for name in STATISTICS if name in table.column_names]
    statistics = [one for one in statistics if one.numbers]
    _draw_sheet(folder, table, pictures / SHEET, progress)
    if quantities:
        draw_histograms(quantities, pictures / VALUES)
    if paired:
        draw_pairs(paired, pictures / PAIRS)
    drawn = [one for one in statistics if not one.is_constant]
    if drawn:
        draw_histograms(drawn, pictures / STATED)
    sizes = np.array(table["bytes"].to_pylist(), dtype=np.int64)
    attempts = [number for number, step in zip(*_columns(table, "attempts", "step"), strict=True) if step == 0]
    return {
        "recipe": recipe,
        "identity": identity,
        "count": table.num_rows,
        "bytes": size_words(int(sizes.sum())),
        "bytes_each": size_words(float(np.median(sizes))),
        "notices": _notices(sampler),
        "bases": [str(base) for base in sampler.bases],
        "varied": varied_rows(sampler),
        "ladders": ladder_rows(sampler),
        "bounds": [bound_words(bound) for bound in recipe.accept],
        "draws": sum(attempts),
        "rejected": sum(attempts) - len(attempts),
        "reasons": _reasons(table),
        "splits": _split_rows(sampler, table),
        "origin": _origin(sampler, identity),
        "warnings": _warnings(table),
        "statistics": _statistics_rows(statistics),
        "sheet": SHEET,
        "images": _IMAGES,
        "values": VALUES if quantities else "",
        "left_out": max(len(quantities) - MOST_CHARTS, 0),
        "pairs": PAIRS if paired else "",
        "stated": STATED if drawn else "",
    }


def _reasons(table: pyarrow.Table) -> list[tuple[str, str]]:
    """Return why draws were refused, each draw once, whatever steps its ladder has."""
    found = Counter[str]()
    for reasons, step in zip(*_columns(table, "rejected", "step"), strict=True):
        found.update(reasons if step == 0 else ())
    return [(reason, format_count(count)) for reason, count in refusal_rows(found)]


def _values_of(table: pyarrow.Table) -> dict[str, list[Any]]:
    """Return drawn values by key, of samples as they were drawn."""
    import pyarrow.compute as pc

    drawn = table.filter(pc.equal(table["step"], 0))
    return {
        name.removeprefix(VALUE): [_read(value) for value in drawn[name].to_pylist()]
        for name in drawn.column_names
        if name.startswith(VALUE)
    }


def _read(value: Any) -> Any:
    """Return what a text of the catalogue stands for: its JSON, or itself."""
    if not isinstance(value, str):
        return value
    try:
        return parse_json(value.encode())
    except ValueError:
        return value


def _statistic(name: str, values: Sequence[float | None]) -> Quantity:
    title, unit = split_unit(name)
    return Quantity(title, unit, tuple(value for value in values if value is not None))


def _statistics_rows(statistics: Sequence[Quantity]) -> list[tuple[str, ...]]:
    told = {split_unit(name)[0]: words for name, words in STATISTICS.items()}
    return [
        (
            one.label,
            told[one.title],
            *(format_number(float(value)) for value in np.quantile(one.numbers, (0.0, 0.5, 1.0))),
        )
        for one in statistics
    ]


def _draw_sheet(folder: DatasetFolder, table: pyarrow.Table, path: Path, progress: Progress | None) -> None:
    """Draw a contact sheet of samples all over the data set, each with the steps of its ladders."""
    numbers, draws, splits = _columns(table, "sample", "draw", "split")
    each = len(draws) // len(set(draws))
    chosen = [
        draw * each + step
        for draw in some_numbers(len(set(draws)), max(ON_A_SHEET // each, 1))
        for step in range(min(each, ON_A_SHEET))
    ]
    images = shown_grey(small_images(folder, table, chosen, progress))
    captions = [" · ".join(filter(None, (str(numbers[place]), splits[place]))) for place in chosen]
    draw_contact_sheet(list(zip(captions, images, strict=True)), _IMAGES, path)


def _columns(table: pyarrow.Table, *names: str) -> list[list[Any]]:
    return [table[name].to_pylist() for name in names]


def _split_rows(sampler: Sampler, table: pyarrow.Table) -> list[tuple[str, str, str, str]]:
    words = split_words(sampler)
    counts, sizes = Counter[str](), Counter[str]()
    for split, size in zip(*_columns(table, "split", "bytes"), strict=True):
        counts[split] += 1
        sizes[split] += size
    return [(name, told, format_count(counts[name]), size_words(sizes[name])) for name, told in words.items()]


def _warnings(table: pyarrow.Table) -> list[tuple[str, str]]:
    found = Counter[str]()
    for entries in table["warnings"].to_pylist():
        found.update(set(entries or ()))
    most = sorted(found.items(), key=lambda one: (-one[1], one[0]))[:_MOST_WARNINGS]
    return [(text, format_count(count)) for text, count in most]


def _notices(sampler: Sampler) -> list[str]:
    recipe = sampler.recipe
    found = [] if recipe.licence else ["No licence is given: nobody may use a data set without one."]
    return found if recipe.citation else [*found, "It is not said how to cite it."]


def _origin(sampler: Sampler, identity: Identity) -> list[tuple[str, str]]:
    recipe = sampler.recipe
    every = recipe.scene_seed == "per_sample"
    return [
        ("recipe", f"dataset.yaml, with its base scenes in it; hash {identity.recipe_hash}"),
        ("seed", f"{recipe.seed}; textures and noise {'differ' if every else 'have the same seed'} in every sample"),
        ("backend", identity.backend + (f" ({identity.platform})" if identity.platform != "auto" else "")),
        ("truth", f"{recipe.truth.views} camera views, {recipe.truth.poses} poses, {recipe.truth.content} content"),
        ("linear images before the sensor", "kept" if recipe.ideal else "not kept"),
        ("versions", ", ".join(f"{name} {version}" for name, version in identity.versions.items())),
    ]
