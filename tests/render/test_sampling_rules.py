"""Rules that average a pixel: transfer of waves, and the finest texture of each."""

from __future__ import annotations

import gc
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from scenetruth.render import sampling_rules
from scenetruth.render.sampling_rules import (
    FILTER_TAPS,
    GAUSS_ORDERS,
    WIDE_ORDERS,
    compute_longest_steps,
    compute_rule_errors,
    compute_widest_steps,
    even_rule,
    filter_transfer,
    gauss_rule,
    gauss_transfer,
    lattice_rule,
    square_rule,
    step_indices,
)
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.texture import SurfaceTexture
from scenetruth.validation_studies.noise_plane import noise_plane
from tests.helpers.nightly import by_night


def test_the_filter_has_the_transfer_of_the_mean_over_a_pixel() -> None:
    frequency = np.linspace(0, 0.25, 101)
    assert FILTER_TAPS.sum() == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(FILTER_TAPS, FILTER_TAPS[::-1], rtol=0, atol=1e-15)
    assert np.abs(filter_transfer(frequency) - np.sinc(frequency)).max() < 1e-4
    # A sampled wave, filtered in the space domain.
    x = np.arange(200)
    for cycles in (0.03, 0.11, 0.24):
        filtered = np.convolve(np.cos(2 * np.pi * cycles * x), FILTER_TAPS, mode="valid")
        expected = filter_transfer(np.array(cycles)) * np.cos(2 * np.pi * cycles * x[3:-3])
        np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("order", GAUSS_ORDERS)
def test_gauss_transfer_is_that_of_its_points(order: int) -> None:
    positions, weights = gauss_rule(order)
    for cycles in (0.0, 0.2, 0.7):
        wave = np.sum(weights * np.exp(2j * np.pi * cycles * positions))
        assert gauss_transfer(order, np.array([cycles]))[0] == pytest.approx(wave.real, abs=1e-12)
        assert abs(wave.imag) < 1e-12


def test_finer_textures_and_smaller_errors_have_shorter_steps() -> None:
    coarse, fine = (build_scene(noise_plane((shortest, 30.0), (60, 80))).bodies[0].texture for shortest in (6.0, 2.0))
    strict, loose = (compute_longest_steps([coarse], error)[0] for error in (1e-5, 1e-3))
    assert (strict[1:] < loose[1:]).all()
    assert (np.diff(loose[1:]) > 0).all()
    # The raster has 16 texels per shortest wave: in texels, both textures are the same up to their draws.
    np.testing.assert_allclose(compute_longest_steps([fine], 1e-3)[0, :-1], loose[:-1], rtol=0.3)


@pytest.mark.parametrize("number", range(len(GAUSS_ORDERS) + 1))
def test_the_error_at_the_longest_step_is_the_stated_error(number: int) -> None:
    texture = build_scene(noise_plane((6.0, 30.0), (100, 120))).bodies[0].texture
    error = 1e-3
    step = compute_longest_steps([texture], error)[0, number]
    rows, columns = texture.shape
    pixels = np.stack(np.meshgrid(np.arange(-3, 44), np.arange(-3, 44)), axis=-1).reshape(-1, 2) * step
    size = np.array([columns, rows])

    def mean(offsets: np.ndarray, weights: np.ndarray) -> np.ndarray:
        values = texture.radiance(((pixels[:, None] + offsets * step) / size).reshape(-1, 2))
        return np.asarray(values.reshape(len(pixels), -1).astype(np.float64) @ weights).reshape(47, 47)

    def square(steps: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = np.meshgrid(steps, steps)
        return np.stack([x.ravel(), y.ravel()], axis=-1), np.outer(weights, weights).ravel()

    exact = mean(*square(*gauss_rule(16)))[3:-3, 3:-3]
    if number == 0:
        samples = mean(np.zeros((1, 2)), np.ones(1))
        across = np.apply_along_axis(np.convolve, 1, samples, FILTER_TAPS, mode="valid")
        found = np.apply_along_axis(np.convolve, 0, across, FILTER_TAPS, mode="valid")
    else:
        found = mean(*square(*gauss_rule(GAUSS_ORDERS[number - 1])))[3:-3, 3:-3]
    ratio = np.sqrt(np.mean((found - exact) ** 2)) / error
    # The error of the steepest rules grows with the 16th power of the step, whose grid has steps of 4 %.
    assert 0.3 < ratio < 1.3


@pytest.mark.parametrize("shortest_mm", [2.0, *by_night(6.0)])
def test_pixels_with_many_texels_are_within_the_stated_error(shortest_mm: float) -> None:
    texture = build_scene(noise_plane((shortest_mm, 30.0), (60, 80))).bodies[0].texture
    error, rng = 1e-4, np.random.default_rng(round(shortest_mm))
    limits = dict(zip(GAUSS_ORDERS, compute_longest_steps([texture], error)[0, 1:], strict=True))
    steps = compute_widest_steps(texture, error, limits[4])
    assert (np.diff(steps) > 0).all()
    assert steps[-1] > 1.5 * limits[8]
    # Lines disregard the mean along the other axis, but have no margin for the number of footprints.
    assert all(steps[WIDE_ORDERS.index(order)] > 0.8 * limits[order] for order in (6, 8))
    # Up to a step, the same.
    few = compute_widest_steps(texture, error, limits[4], steps[3])
    np.testing.assert_array_equal(few, np.minimum(steps, steps[3]))
    rows, columns = texture.shape
    for step, order in zip(steps.tolist(), WIDE_ORDERS, strict=True):
        # Other places, orientations and shapes than those of the search, and samples on an even grid.
        angle, centre = rng.uniform(0, 2 * np.pi, 60), rng.random((60, 2)) * (columns, rows)
        along = step * np.column_stack([np.cos(angle), np.sin(angle)])
        across = step * rng.uniform(0.3, 1, (60, 1)) * np.column_stack([-np.sin(angle), np.cos(angle)])

        means = []
        for offsets, weights in (square_rule(*even_rule(80)), square_rule(*gauss_rule(order)), lattice_rule(257)):
            points = centre[:, None] + offsets[:, :1] * along[:, None] + offsets[:, 1:] * across[:, None]
            values = texture.radiance((points / (columns, rows)).reshape(-1, 2))
            means.append(values.reshape(60, -1).astype(np.float64) @ weights)
        by_rule, by_lattice = (np.sqrt(np.mean((found - means[0]) ** 2)) for found in means[1:])
        # A lattice with about as many samples as the last rule has larger errors.
        assert by_rule < min(error, by_lattice)


def test_no_further_rules_without_a_longest_step() -> None:
    texture = build_scene(noise_plane((6.0, 30.0), (60, 80))).bodies[0].texture
    for least in (0.0, np.inf):
        assert not compute_widest_steps(texture, 1e-4 / (1 + least), least).any()


def test_scenes_that_are_built_again_need_no_further_search(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = noise_plane((6.0, 30.0), (60, 80))
    first, again = (build_scene(scene).bodies[0].texture for _ in range(2))
    other = build_scene(scene.model_copy(update={"seed": scene.seed + 1})).bodies[0].texture
    steps = compute_longest_steps([first], 2e-4)
    searches: list[object] = []
    search = sampling_rules._rule_errors

    def counted(texture: SurfaceTexture) -> np.ndarray:
        searches.append(texture)
        return search(texture)

    monkeypatch.setattr(sampling_rules, "_rule_errors", counted)
    assert (compute_longest_steps([again, first], 2e-4) == steps).all()
    assert not searches
    compute_longest_steps([other], 2e-4)
    assert searches == [other]


@dataclass(frozen=True)
class Flat:
    """A texture that equals others with its value."""

    value: float
    shape = (2, 2)
    tiled = True

    def radiance(self, uv: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.full(len(uv), self.value, dtype=np.float32)


def test_errors_outlive_an_equal_texture() -> None:
    first = [Flat(0.25)]
    compute_rule_errors(cast("Any", first))

    class Releasing(Flat):
        def radiance(self, uv: NDArray[np.float64]) -> NDArray[np.float32]:
            first.clear()
            gc.collect()
            return super().radiance(uv)

    again = cast("Any", [Flat(0.25), Releasing(0.5)])
    errors = compute_rule_errors(again)
    assert not first
    # A uniform texture has no error.
    assert errors.shape[:2] == (2, 1 + len(GAUSS_ORDERS))
    assert np.abs(errors).max() < 1e-6


def test_the_longest_steps_are_those_within_the_errors() -> None:
    texture = build_scene(noise_plane((6.0, 30.0), (60, 80))).bodies[0].texture
    (errors,) = compute_rule_errors([texture])
    assert errors.shape[0] == 1 + len(GAUSS_ORDERS)
    assert (np.diff(errors, axis=1) >= 0).all()
    assert (np.diff(errors[1:], axis=0) <= 0).all()
    for error in (1e-5, 1e-4, 1e-3):
        (longest,) = compute_longest_steps([texture], error)
        rules = np.arange(len(longest))
        inside = longest > 0
        assert inside[1:].all()
        assert (errors[rules, step_indices(longest)] <= error)[inside].all()
        assert (errors[rules, step_indices(1.05 * longest)] > error)[inside & np.isfinite(longest)].all()


def test_steps_between_those_tried_have_the_error_of_the_next() -> None:
    exact = 2.0 ** np.arange(-6, 6.01, 0.0625)
    np.testing.assert_array_equal(step_indices(exact * (1 - 1e-9)), np.arange(len(exact)))
    assert step_indices(np.array([0.0, 1e-9, 1e9, np.inf])).tolist() == [0, 0, len(exact) - 1, len(exact) - 1]
