"""The card of a data set: its contents, with images and statistics, and its files."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from scenetruth.dataset.catalogue import read_catalogue
from scenetruth.dataset.checksums import list_path, write_checksums
from scenetruth.dataset.fingerprint import DatasetFingerprint, open_sampler, read_fingerprint
from scenetruth.dataset.layout import DatasetFolder
from scenetruth.dataset.pages.croissant import VALUE, Publication, build_croissant, cite
from scenetruth.dataset.pages.figures import (
    MOST_CHARTS,
    ON_A_SHEET,
    THUMBNAIL_PX,
    PlotQuantity,
    collect_quantities,
    draw_contact_sheet,
    draw_histograms,
    draw_pairs,
    select_paired,
    to_display_grey,
)
from scenetruth.dataset.pages.page_text import (
    describe_criterion,
    describe_scene,
    describe_splits,
    format_size,
    render_html,
    render_markdown,
    split_unit,
    tabulate_distributions,
    tabulate_paired_factors,
    tabulate_rejections,
)
from scenetruth.dataset.reading import SceneDataset
from scenetruth.dataset.recipe_validation import select_numbers
from scenetruth.dataset.sampler import Sampler
from scenetruth.dataset.samples import STATISTICS
from scenetruth.errors import StoreError
from scenetruth.number_format import format_count, format_number
from scenetruth.output import check_output, claim_file, claim_pictures, write_atomically
from scenetruth.plain_data import parse_json
from scenetruth.progress import Progress

if TYPE_CHECKING:
    import pyarrow

__all__ = ["write_card"]


def load_thumbnails(
    folder: DatasetFolder, table: pyarrow.Table, places: Sequence[int], progress: Progress | None = None
) -> list[NDArray[np.float32]]:
    """Return downscaled images of the reference camera at t = 0, from 0 to 1 of full scale."""
    dataset = SceneDataset(folder, table.select(["sample"]).to_pandas())
    found = []
    for done, place in enumerate(places):
        if progress is not None:
            progress("images", done, len(places))
        found.append(_small(dataset.sample(place).recording))
    if progress is not None:
        progress("images", len(places), len(places))
    return found


def _small(recording: xr.Dataset) -> NDArray[np.float32]:
    from PIL import Image

    image = recording["image"]
    # Only this image is loaded.
    image = image.sel({name: 0 for name in ("s_y", "s", "t") if name in image.dims})
    values = np.asarray(image, dtype=np.float32) / np.float32(recording.attrs.get("full_scale", 1.0))
    values = values.mean(axis=-1) if "channel" in image.dims else values
    height, width = values.shape
    share = min(THUMBNAIL_PX / max(width, height), 1.0)
    size = max(round(width * share), 1), max(round(height * share), 1)
    return np.asarray(Image.fromarray(values).resize(size, Image.Resampling.BOX))


SHEET, VALUES, PAIRS, STATED = "contact_sheet.png", "values.png", "pairs.png", "statistics.png"
_IMAGES = "Images of the reference camera (s = 0) at t = 0, downscaled, with a common grey scale."
_MOST_WARNINGS = 10


def build_card_contents(
    folder: DatasetFolder,
    sampler: Sampler,
    identity: DatasetFingerprint,
    table: pyarrow.Table,
    pictures: Path,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Draw the figures of a card, and return the contents of its templates."""
    recipe = sampler.recipe
    quantities = collect_quantities(sampler, _list_values(table))
    paired = select_paired(quantities)
    statistics = [_statistic(name, table[name].to_pylist()) for name in STATISTICS if name in table.column_names]
    statistics = [one for one in statistics if one.numbers]
    _draw_sheet(folder, table, pictures / SHEET, progress)
    copies: dict[str, dict[str, Any]] = {}
    if quantities:
        copies[VALUES] = _copies(draw_histograms(quantities, pictures / VALUES), quantities[:MOST_CHARTS])
    if paired:
        copies[PAIRS] = _copies(draw_pairs(paired, pictures / PAIRS), paired)
    drawn = [one for one in statistics if not one.is_constant]
    if drawn:
        copies[STATED] = _copies(draw_histograms(drawn, pictures / STATED), drawn[:MOST_CHARTS])
    sizes = np.array(table["bytes"].to_pylist(), dtype=np.int64)
    attempts = [number for number, step in zip(*_columns(table, "attempts", "step"), strict=True) if step == 0]
    return {
        "recipe": recipe,
        "identity": identity,
        "count": table.num_rows,
        "bytes": format_size(int(sizes.sum())),
        "bytes_each": format_size(float(np.median(sizes))),
        "notices": _notices(sampler),
        "bases": [describe_scene(base) for base in sampler.bases],
        "varied": tabulate_distributions(sampler),
        "ladders": tabulate_paired_factors(sampler),
        "bounds": [describe_criterion(bound) for bound in recipe.acceptance],
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
        "copies": copies,
    }


def _copies(svg: str, quantities: Sequence[PlotQuantity]) -> dict[str, Any]:
    """Return what the page offers to copy of a figure: the SVG, and rows of its values under their titles."""
    columns: list[list[Any]] = [
        list(one.numbers) or [value for value, count in one.counts for _ in range(count)] for one in quantities
    ]
    longest = max(map(len, columns), default=0)
    padded = [[*column, *[""] * (longest - len(column))] for column in columns]
    return {"svg": svg, "rows": [[one.label for one in quantities], *map(list, zip(*padded, strict=True))]}


def _reasons(table: pyarrow.Table) -> list[tuple[str, str]]:
    found = Counter[str]()
    for reasons, step in zip(*_columns(table, "rejected", "step"), strict=True):
        found.update(reasons if step == 0 else ())
    return [(reason, format_count(count)) for reason, count in tabulate_rejections(found)]


def _list_values(table: pyarrow.Table) -> dict[str, list[Any]]:
    import pyarrow.compute as pc

    drawn = table.filter(pc.equal(table["step"], 0))
    return {
        name.removeprefix(VALUE): [_read(value) for value in drawn[name].to_pylist()]
        for name in drawn.column_names
        if name.startswith(VALUE)
    }


def _read(value: Any) -> Any:
    """Return the JSON value of a text of the catalogue, or the text itself."""
    if not isinstance(value, str):
        return value
    try:
        return parse_json(value.encode())
    except ValueError:
        return value


def _statistic(name: str, values: Sequence[float | None]) -> PlotQuantity:
    title, unit = split_unit(name)
    return PlotQuantity(title, unit, tuple(value for value in values if value is not None))


def _statistics_rows(statistics: Sequence[PlotQuantity]) -> list[tuple[str, ...]]:
    stated = {split_unit(name)[0]: words for name, words in STATISTICS.items()}
    return [
        (
            one.label,
            stated[one.title],
            *(format_number(float(value)) for value in np.quantile(one.numbers, (0.0, 0.5, 1.0))),
        )
        for one in statistics
    ]


def _draw_sheet(folder: DatasetFolder, table: pyarrow.Table, path: Path, progress: Progress | None) -> None:
    numbers, draws, splits = _columns(table, "sample", "draw", "split")
    each = len(draws) // len(set(draws))
    chosen = [
        draw * each + step
        for draw in select_numbers(len(set(draws)), max(ON_A_SHEET // each, 1))
        for step in range(min(each, ON_A_SHEET))
    ]
    images = to_display_grey(load_thumbnails(folder, table, chosen, progress))
    captions = [" · ".join(filter(None, (str(numbers[place]), splits[place]))) for place in chosen]
    draw_contact_sheet(list(zip(captions, images, strict=True)), _IMAGES, path)


def _columns(table: pyarrow.Table, *names: str) -> list[list[Any]]:
    return [table[name].to_pylist() for name in names]


def _split_rows(sampler: Sampler, table: pyarrow.Table) -> list[tuple[str, str, str, str]]:
    words = describe_splits(sampler)
    counts, sizes = Counter[str](), Counter[str]()
    for split, size in zip(*_columns(table, "split", "bytes"), strict=True):
        counts[split] += 1
        sizes[split] += size
    return [(name, stated, format_count(counts[name]), format_size(sizes[name])) for name, stated in words.items()]


_NUMBER = re.compile(r"(?<![\w.'])-?\d+(?:\.\d+)?(?:e-?\d+)?(?!\w|\.\d)")


def _warnings(table: pyarrow.Table) -> list[tuple[str, str]]:
    """Return warnings and the number of samples that have them; those that differ by their numbers are one."""
    samples: dict[str, set[int]] = {}
    texts: dict[str, set[str]] = {}
    for number, entries in enumerate(table["warnings"].to_pylist()):
        for text in entries or ():
            kind = _NUMBER.sub("#", text)
            samples.setdefault(kind, set()).add(number)
            texts.setdefault(kind, set()).add(text)
    found = {merge_numbers(texts[kind]): len(which) for kind, which in samples.items()}
    most = sorted(found.items(), key=lambda one: (-one[1], one[0]))[:_MOST_WARNINGS]
    return [(text, format_count(count)) for text, count in most]


def merge_numbers(texts: Collection[str]) -> str:
    """Return one text for those that differ by their numbers only, with the ranges of these.

    >>> merge_numbers({"waves of 0.94 px in 3 images", "waves of 0.97 px in 3 images", "waves of 0.9 px in 3 images"})
    'waves of 0.9 to 0.97 px in 3 images'
    """
    each = [_NUMBER.findall(text) for text in sorted(texts)]
    ends = [(min(column, key=float), max(column, key=float)) for column in zip(*each, strict=True)]
    spelled = iter([low if float(low) == float(high) else f"{low} to {high}" for low, high in ends])
    return _NUMBER.sub(lambda _: next(spelled), min(texts))


def _notices(sampler: Sampler) -> list[str]:
    recipe = sampler.recipe
    found = [] if recipe.licence else ["No licence is specified: a data set without a licence may not be used."]
    return found


def _origin(sampler: Sampler, identity: DatasetFingerprint) -> list[tuple[str, str]]:
    recipe = sampler.recipe
    every = recipe.scene_seed == "per_sample"
    return [
        ("recipe", f"dataset.yaml, including its base scenes; hash {identity.recipe_hash}"),
        ("seed", f"{recipe.seed}; textures and noise {'differ' if every else 'have the same seed'} in every sample"),
        ("backend", identity.backend + (f" ({identity.platform})" if identity.platform != "auto" else "")),
        ("truth", f"{recipe.truth.views} camera views, {recipe.truth.poses} poses, {recipe.truth.content} content"),
        ("linear images before the sensor", "stored" if recipe.save_radiance else "not stored"),
        ("versions", ", ".join(f"{name} {version}" for name, version in identity.versions.items())),
    ]


def write_card(
    dataset: str | Path,
    *,
    version: str = "1.0.0",
    date: str = "",
    url: str = "",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write the card of a data set with images and distributions, and its metadata; the output is reproducible.

    Parameters
    ----------
    dataset
        Directory of a complete data set.
    version, date, url
        Version, date of publication (``YYYY-MM-DD``) and address of the published data set; default: those of the
        recipe.
    overwrite
        Whether an existing card may be replaced.
    progress
        Called with (what, done, total).

    Returns
    -------
    pathlib.Path
        The page ``card.html``; ``card.md`` and ``croissant.json`` are written next to it.

    Raises
    ------
    StoreError
        If the data set is incomplete or damaged.
    RecipeError
        If version, date or address are invalid.
    OutputExistsError
        If a card exists and ``overwrite`` is false.

    See Also
    --------
    run_dataset : Generates the data set.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 100]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> plain = {"camera": {"width": 40, "height": 30, "focal_length_px": 60}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> recipe = {"name": "walls", "base": plain, "samples": 2, "licence": "CC-BY-4.0"}
    >>> with TemporaryDirectory() as folder:
    ...     made = st.run_dataset(recipe, output=f"{folder}/walls")
    ...     st.write_card(f"{folder}/walls", version="1.1.0").name
    'card.html'
    """
    places = DatasetFolder(dataset)
    identity = read_fingerprint(places)
    sampler = open_sampler(places)
    if not places.catalogue.exists():
        remedy = f"generate the missing samples first: scenetruth dataset run {places.recipe} -o {places.path}"
        raise StoreError(places.path, f"is incomplete, and has no catalogue yet; {remedy}")
    targets = {
        places.card_pictures: claim_pictures,
        places.card: claim_file,
        places.card_text: claim_file,
        places.croissant: claim_file,
    }
    for target, claim in targets.items():
        check_output(target, overwrite=overwrite, claim=claim)
    table = read_catalogue(places, sampler)
    recipe = sampler.recipe
    published = Publication(version, date or recipe.published, url or recipe.address)
    with ExitStack() as stack:
        # Files are moved into place when all are complete, the page after its figures.
        asides = [
            stack.enter_context(write_atomically(target, overwrite=overwrite, claim=claim))
            for target, claim in reversed(targets.items())
        ]
        croissant, text, page, pictures = asides
        pictures.mkdir()
        contents = build_card_contents(places, sampler, identity, table, pictures, progress)
        contents |= {"published": published, "citation": cite(recipe, published), "pictures": places.card_pictures.name}
        page.write_text(render_html("card.html.j2", **contents), encoding="utf-8")
        text.write_text(render_markdown("card.md.j2", **contents), encoding="utf-8")
        metadata = build_croissant(places, sampler, table, published)
        croissant.write_text(json.dumps(metadata, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    written = [places.card, places.card_text, places.croissant]
    write_checksums(list_path(places.card), [*written, *sorted(places.card_pictures.iterdir())])
    return places.card
