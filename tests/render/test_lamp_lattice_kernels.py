"""Values that are computed at few pixels and interpolated between them, on functions that are known everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.render.lamp_lattice_kernels import COARSEST, EXACT, LEVELS, SURE, UNKNOWN, find_bends, predict_level

Floats = NDArray[np.float64]
SHAPE = (41, 57)
TOLERANCE = 2e-3
ROWS, COLUMNS = np.indices(SHAPE, dtype=np.float64)
SURFACE = np.ones(SHAPE, dtype=np.int32)


def interpolated(exact: Floats) -> tuple[Floats, NDArray[np.bool_], NDArray[np.uint8]]:
    """Return values after all levels, the pixels at which they are exact, and what is known of each pixel."""
    values, error = np.full((*SHAPE, 2), np.nan), np.full(SHAPE, np.inf)
    known, computed = np.full(SHAPE, UNKNOWN, dtype=np.uint8), np.zeros(SHAPE, dtype=np.bool_)
    wanted = np.zeros(SHAPE, dtype=np.bool_)
    wanted[::COARSEST, ::COARSEST] = True
    for level in (None, *LEVELS):
        if level is not None:
            wanted = predict_level(*level, SURFACE, known, values, error, TOLERANCE)
        differs = np.abs(values[..., 0] - exact)[wanted]
        error[wanted] = np.where(np.isnan(differs), np.inf, differs)
        values[wanted], known[wanted] = exact[wanted][:, None], EXACT
        computed |= wanted
    assert (known == EXACT).all()
    return values[..., 0], computed, known


def test_planes_are_interpolated_from_the_first_pixels() -> None:
    """Inside the first pixels, where each new pixel is on two lines between others."""
    plane = 0.2 + 0.007 * ROWS + 0.004 * COLUMNS
    values, computed, known = interpolated(plane)
    assert values == pytest.approx(plane, abs=1e-14)
    inside = np.s_[COARSEST : SHAPE[0] - COARSEST, COARSEST : SHAPE[1] - COARSEST]
    # The second level is the first that has predictions to compare with.
    assert computed[inside].mean() < 0.05
    both = np.repeat(values[..., None], 2, axis=-1)
    assert not find_bends(SURFACE, known, both, 1e-9).any()


def shaded(turn: float, x: float, y: float, width: float, depth: float) -> Floats:
    """Return the share of light behind a bar at an angle, whose penumbrae are linear and bend at their borders."""
    place = np.cos(turn) * (COLUMNS - x) + np.sin(turn) * (ROWS - y)
    return np.asarray(1.0 - depth * np.clip(1.0 - np.abs(place) / width, 0.0, 1.0))


def refined(exact: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return values with those next to bends computed, and which pixels are."""
    values, computed, known = interpolated(exact)
    computed |= find_bends(SURFACE, known, np.repeat(values[..., None], 2, axis=-1), TOLERANCE)
    return np.where(computed, exact, values), computed


@pytest.mark.parametrize(("angle", "width"), [(20.0, 6.0), (65.0, 11.0), (0.0, 9.0), (45.0, 16.0)])
def test_bends_are_computed(angle: float, width: float) -> None:
    """Interpolation between pixels on both sides of a bend of Δ per px has an error of up to Δ/2 of a px."""
    exact = shaded(np.radians(angle), 27.3, 19.6, width, 0.5)
    values, computed = refined(exact)
    assert np.abs(values - exact).max() < TOLERANCE
    # Away from the bends, nothing has to be computed.
    assert computed.mean() < 0.7


def test_errors_beyond_the_tolerance_are_rare() -> None:
    """Bends that no computed value shows remain: without comparing lines, in ten times as many pixels."""
    rng = np.random.default_rng(8)
    beyond = []
    for _ in range(100):
        exact = shaded(*rng.uniform([0, 15, 10, 5, 0.1], [np.pi, 40, 30, 30, 0.5]))
        values, _ = refined(exact)
        beyond.append(np.mean(np.abs(values - exact) > TOLERANCE))
    assert np.mean(beyond) < 4e-4


def test_neighbours_of_bends_on_the_same_surface_are_returned() -> None:
    values = np.full((*SHAPE, 2), 0.5)
    values[10, 20, 1] += 3 * TOLERANCE
    known, label = np.full(SHAPE, EXACT, dtype=np.uint8), SURFACE.copy()
    label[:, 22:] = 2
    known[8] = SURE
    # The value and those beside it bend: up to two pixels away along rows and columns, one across.
    expected = np.zeros(SHAPE, dtype=np.bool_)
    expected[9:12, 18:23] = expected[8:13, 19:22] = True
    expected[8] = expected[:, 22:] = False
    np.testing.assert_array_equal(find_bends(label, known, values, TOLERANCE), expected)
    assert not find_bends(label, known, values, 4 * TOLERANCE).any()
