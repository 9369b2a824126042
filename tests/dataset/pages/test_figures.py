"""Charts and contact sheets: the same bytes each time, whatever the values are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenetruth.dataset.pages import (
    PlotQuantity,
    draw_contact_sheet,
    draw_histograms,
    draw_pairs,
    select_paired,
    to_display_grey,
)

NUMBERS = tuple(float(number) for number in np.random.default_rng(1).random(40))
SQUARED = tuple(number**2 for number in NUMBERS)


def test_charts_of_all_sorts(tmp_path: Path) -> None:
    sorts = [
        PlotQuantity("even", "mm", NUMBERS),
        PlotQuantity("logarithmic", "", SQUARED, log=True),
        PlotQuantity("alike", "", (2.0,) * 9),
        PlotQuantity("one", "", (1.5,)),
        PlotQuantity("whole", "", (1.0, 2.0) * 6),
        PlotQuantity("measured", "", (1 / 3, 2 / 3) * 6),
        PlotQuantity("$x_{1}$ \x00 words " * 9, "", counts=(("$\\alpha$", 3), ("b" * 90, 1))),
    ]
    for path in (tmp_path / "one.png", tmp_path / "two.png"):
        draw_histograms(sorts, path)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    draw_pairs(sorts[:2], tmp_path / "pairs.png")
    with Image.open(tmp_path / "pairs.png") as drawn:
        assert drawn.size[0] > 300


def test_pairs_are_of_numbers_that_say_something() -> None:
    twice = PlotQuantity("twice", "", tuple(2 * number for number in NUMBERS))
    against = PlotQuantity("against", "", tuple(-number for number in NUMBERS))
    few = PlotQuantity("few", "", (1.0, 2.0) * 20)
    free = PlotQuantity("free", "", NUMBERS[::-1])
    first = PlotQuantity("first", "", NUMBERS)
    words = PlotQuantity("words", "", counts=(("a", 40),))
    assert select_paired([first, twice, against, few, words, free]) == [first, free]
    assert select_paired([first, twice]) == []


@pytest.mark.parametrize("count", [1, 9])
def test_sheet(count: int, tmp_path: Path) -> None:
    images = [np.full((12, 16), number / 9, dtype=np.float32) for number in range(count)]
    grey = to_display_grey(images)
    draw_contact_sheet([(str(number), image) for number, image in enumerate(grey)], "small", tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.info["Software"] == "scenetruth"
        assert sheet.size[1] > -(-count // 8) * 12


def test_dark_images_are_dark_beside_bright_ones() -> None:
    dark, bright = to_display_grey([np.full((4, 4), 0.1), np.full((4, 4), 0.8)])
    assert dark.max() < bright.min() / 2
    assert to_display_grey([]) == []
    assert to_display_grey([np.zeros((2, 2))])[0].max() == 0
