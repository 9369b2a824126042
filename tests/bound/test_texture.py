"""Derivatives of images, and the pieces of surface where they are taken."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from scenetruth.bound.image_gradients import gradient_along
from scenetruth.bound.surface_geometry import compute_interior_mask, label_surface_segments


@pytest.mark.parametrize(("wavelength_px", "error"), [(12.0, 5e-6), (6.0, 3.4e-4), (4.0, 5.4e-3), (3.0, 0.047)])
def test_derivatives_are_as_exact_as_stated(wavelength_px: float, error: float) -> None:
    """Of waves, away from the ends; the errors follow from the transfer function of quintic splines."""
    x = np.arange(240.0)
    k = 2 * np.pi / wavelength_px
    wave = np.sin(k * x + 0.3)
    for axis in (0, 1):
        image = np.broadcast_to(wave[:, None] if axis == 0 else wave, (240, 240))
        found = gradient_along(image, axis)
        line = found[:, 120] if axis == 0 else found[120]
        exact = k * np.cos(k * x + 0.3)
        share = float(line[30:-30] @ exact[30:-30]) / float(exact[30:-30] @ exact[30:-30])
        assert 0 < 1 - share < error
        assert 1 - share > 0.5 * error


def test_a_step_beyond_a_piece_is_hardly_felt_inside() -> None:
    """A tenth of a step 3 px away, as pixels at the end of `compute_interior_mask` have it."""
    image = np.zeros((60, 60))
    image[:, 30:] = 1.0
    gradient = np.abs(gradient_along(image, 1)[30])
    assert gradient[27] < 0.12
    assert gradient[24] < 0.01
    pieces = np.where(np.arange(60) < 30, 0, 1) + np.zeros((60, 1), dtype=np.int64)
    assert compute_interior_mask(pieces)[30].nonzero()[0].tolist() == [*range(28), *range(32, 60)]


def test_pieces_end_at_edges_and_at_objects() -> None:
    """Two faces of one object with an edge between them, and another object."""
    depth = np.full((10, 12), 100.0)
    depth[0] = np.nan
    mixed = np.zeros(depth.shape, dtype=bool)
    mixed[:, 4] = True
    objects = np.zeros(depth.shape, dtype=int)
    objects[:, 9:] = 1
    maps = {"depth": depth, "mixed": mixed, "object_id": objects}
    pieces = label_surface_segments(xr.Dataset({name: (("y", "x"), values) for name, values in maps.items()}))
    assert (pieces[0] == -1).all()
    assert (pieces[:, 4] == -1).all()
    parts = [pieces[1:, :4], pieces[1:, 5:9], pieces[1:, 9:]]
    assert [np.unique(part).size for part in parts] == [1, 1, 1]
    assert np.unique([part[0, 0] for part in parts]).tolist() == [0, 1, 2]
