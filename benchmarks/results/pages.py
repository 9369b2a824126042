"""Writes tables, figures and fragments into the pages of the site.

A page holds a fragment between two comments, ``<!-- results: NAME -->`` and ``<!-- end -->``; all other text is written
by hand and stays.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import pandas as pd

from benchmarks.results.data import read_methods_data, write_csv
from benchmarks.results.figures import draw_errors, draw_resolution
from benchmarks.results.four_images import COLUMNS
from benchmarks.results.fragments import FRAGMENTS, Results
from scenetruth.output import write_atomically

__all__ = ["PAGES", "fragments_of", "read_results", "with_fragments", "write_pages"]

PAGES = ("index.md", "benchmark.md", "dic_programs.md")
_FRAGMENT = re.compile(r"(<!-- results: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
FOUR_IMAGES = "four_images.csv"


def read_results(docs: Path) -> Results:
    """Return the results that the data of the site hold.

    Parameters
    ----------
    docs
        Folder of the pages.
    """
    file = docs / "data" / FOUR_IMAGES
    four = pd.read_csv(file, dtype={"options": str}) if file.exists() else pd.DataFrame(columns=list(COLUMNS))
    return Results(read_methods_data(docs / "data" / "methods"), four)


def with_fragments(text: str, results: Results, fragments: Mapping[str, Callable[[Results], str]] = FRAGMENTS) -> str:
    """Return a page with its fragments made anew.

    Parameters
    ----------
    text
        The page.
    results
        The data.
    fragments
        What makes each fragment.

    Notes
    -----
    Fragments of other names stay as they are: other programs write them.
    """

    def made(found: re.Match[str]) -> str:
        return f"{found[1]}\n{fragments[found[2]](results)}\n\n{found[3]}" if found[2] in fragments else found[0]

    return _FRAGMENT.sub(made, text)


def fragments_of(text: str) -> list[str]:
    """Return the names of the fragments of a page.

    Parameters
    ----------
    text
        The page.
    """
    return [name for _, name, _ in _FRAGMENT.findall(text)]


def write_pages(docs: Path) -> list[Path]:
    """Write the derived tables, the figures and the fragments; return the files.

    Parameters
    ----------
    docs
        Folder of the pages.
    """
    results = read_results(docs)
    data = docs / "data"
    written = []
    for name, frame in (
        ("losses.csv", results.losses),
        ("errors.csv", results.relative),
        ("overview.csv", results.overview),
        ("error_bars.csv", results.bars),
    ):
        write_csv(data / name, frame)
        written.append(data / name)
    written += [draw_resolution(results, data / "resolution.svg"), draw_errors(results, data / "errors.svg")]
    for name in PAGES:
        page = docs / name
        text = page.read_text(encoding="utf-8")
        with write_atomically(page, overwrite=True) as partial:
            partial.write_text(with_fragments(text, results), encoding="utf-8")
        written.append(page)
    return written
