"""Surfaces of a depth map: separated by steps above the noise, one across gaps, the largest first."""

from __future__ import annotations

import numpy as np
import pytest

from scenetruth.scoring.surface_labels import fill_std, label_surfaces

FOCAL_PX = 1000.0
SHAPE = (60, 80)


def step(height_mm: float) -> np.ndarray:
    depth = np.full(SHAPE, 600.0)
    depth[:, 50:] -= height_mm
    return depth


# A slope of 80° is tan(80°) 600 mm / 1000 px = 3.4 mm from pixel to pixel; noise of 0.2 mm adds 4 √2 0.2 mm = 1.13 mm.
@pytest.mark.parametrize(("height_mm", "count"), [(3.0, 1), (4.4, 1), (4.7, 2), (20.0, 2)])
def test_steps_above_slope_and_noise_separate(height_mm: float, count: int) -> None:
    labels = label_surfaces(step(height_mm), np.full(SHAPE, 0.2), FOCAL_PX)
    assert labels.max() == count
    assert (labels[:, :50] == 1).all()
    assert (labels[:, 50:] == count).all()


def test_gaps_do_not_separate_where_depths_agree() -> None:
    for height_mm, count in ((0.0, 1), (40.0, 2)):
        depth = step(height_mm)
        depth[:, 45:55] = np.nan
        labels = label_surfaces(depth, fill_std(np.full(SHAPE, 0.2), np.isfinite(depth)), FOCAL_PX)
        assert labels.max() == count
        assert (labels[:, 45:55] == 0).all()


def test_surfaces_are_sorted_by_size_and_specks_are_none() -> None:
    depth = step(30.0)
    depth[:, :30] = 500.0
    depth[2:7, 5:10] = 450.0
    labels = label_surfaces(depth, np.full(SHAPE, 0.1), FOCAL_PX)
    sizes = [int((labels == number).sum()) for number in range(1, int(labels.max()) + 1)]
    assert sizes == sorted(sizes, reverse=True) == [1800, 1775, 1200]
    assert (labels[2:7, 5:10] == 0).all()


def test_missing_deviations_are_those_nearby_or_the_median() -> None:
    known = np.ones(SHAPE, dtype=bool)
    std = np.full(SHAPE, 0.2)
    std[0, 0] = np.nan
    std[5, 5] = 0.0
    filled = fill_std(std, known)
    assert filled == pytest.approx(np.full(SHAPE, 0.2))
    assert (fill_std(np.full(SHAPE, np.nan), known) == 1.0).all()
