"""The card of a data set and its metadata, written into its folder."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path

from scenetruth.dataset.card.contents import card_contents
from scenetruth.dataset.card.croissant import croissant_of
from scenetruth.dataset.card.publication import Publication
from scenetruth.dataset.catalogue.store import read_catalogue
from scenetruth.dataset.folder import DatasetFolder
from scenetruth.dataset.identity import open_sampler, read_identity
from scenetruth.dataset.pages.writing import render_html, render_markdown
from scenetruth.errors import StoreError
from scenetruth.placing import check_output, claim_file, claim_pictures, write_aside
from scenetruth.progress import Progress

__all__ = ["write_card"]


def write_card(
    folder: str | Path,
    publication: Publication | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Describe a data set: a card for people, with real images and distributions, and metadata for machines.

    All of it is the same for the same data set.

    Parameters
    ----------
    folder
        The data set, with all its samples. Into it go ``card.html``, ``card.md``, their pictures in ``card``, and
        ``croissant.json``.
    publication
        Version, date and address; version 1.0.0 if not given.
    overwrite
        Whether earlier ones may be replaced.
    progress
        Called with (what, done, total).

    Returns
    -------
    pathlib.Path
        The card, ``card.html``.

    Raises
    ------
    StoreError
        If there is no data set, or samples of it are missing.
    OutputExistsError
        If it has a card, and that may not be replaced.
    """
    places = DatasetFolder(folder)
    identity = read_identity(places)
    sampler = open_sampler(places)
    if not places.catalogue.exists():
        remedy = f"make the rest first: scenetruth dataset run {places.recipe} -o {places.path}"
        raise StoreError(places.path, f"is not whole, and has no catalogue yet; {remedy}")
    targets = {
        places.card_pictures: claim_pictures,
        places.card: claim_file,
        places.card_text: claim_file,
        places.croissant: claim_file,
    }
    for target, claim in targets.items():
        check_output(target, overwrite=overwrite, claim=claim)
    table = read_catalogue(places, sampler)
    published = publication or Publication()
    with ExitStack() as stack:
        # They come to their places when all are whole, the page after its pictures.
        asides = [
            stack.enter_context(write_aside(target, overwrite=overwrite, claim=claim))
            for target, claim in reversed(targets.items())
        ]
        croissant, text, page, pictures = asides
        pictures.mkdir()
        contents = card_contents(places, sampler, identity, table, pictures, progress)
        contents |= {"published": published, "pictures": places.card_pictures.name}
        page.write_text(render_html("card.html.j2", **contents), encoding="utf-8")
        text.write_text(render_markdown("card.md.j2", **contents), encoding="utf-8")
        metadata = croissant_of(places, sampler, table, published)
        croissant.write_text(json.dumps(metadata, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return places.card
