"""The waves of textures, against their definitions, against closed formulas, and against what is painted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from scenetruth.bound import texture_gradient
from scenetruth.design.prediction import SpectralComponents, analytic_spectra, compute_ring_spectrum, measure_spectrum
from scenetruth.scene import Scene
from tests.helpers.prediction_scenes import wall


def waves_of(texture: dict[str, Any], **changes: Any) -> SpectralComponents:
    item = Scene.from_dict(wall(texture=texture, **changes)).objects[0]
    return analytic_spectra()[item.texture.kind].waves(item.texture)


def gradient_of(waves: SpectralComponents, axis: int) -> float:
    """The rms of the derivative along an axis of the surface, per mm."""
    return float(np.sqrt(np.sum(waves.variances * (2 * np.pi * waves.frequencies_per_mm[:, axis]) ** 2)))


@given(shortest=some.floats(0.1, 5.0), octaves=some.floats(0.05, 4.0), exponent=some.floats(-4.0, 2.0))
def test_noise_has_the_gradient_of_the_closed_formula(shortest: float, octaves: float, exponent: float) -> None:
    """Gauss's rule with eight nodes errs by less than 1e-3 for exp(8 u) over [-1, 1], the steepest power here."""
    band = (shortest, shortest * 2**octaves)
    waves = compute_ring_spectrum(band, exponent, 0.04, 0.5)
    assert waves.contrast == pytest.approx(0.2)
    assert gradient_of(waves, 0) == pytest.approx(texture_gradient(0.2, band, exponent), rel=2e-3)
    assert gradient_of(waves, 1) == pytest.approx(gradient_of(waves, 0), rel=1e-9)


def test_plaid_is_two_waves() -> None:
    """The mean square of A cos a cos b is A²/4, that of its derivative A² k² / 4."""
    waves = waves_of({"kind": "plaid", "wavelength_mm": [4.0, 8.0], "amplitude": 0.4})
    assert waves.contrast == pytest.approx(0.2)
    assert gradient_of(waves, 0) == pytest.approx(0.2 * 2 * np.pi / 4.0)
    assert gradient_of(waves, 1) == pytest.approx(0.2 * 2 * np.pi / 8.0)


def test_checkerboard_has_the_variance_of_two_radiances() -> None:
    """Of a square wave, odd overtones up to the 31st hold 1 - 0.013 of the variance, and of a product the square."""
    waves = waves_of({"kind": "checkerboard", "square_mm": 3.0, "radiances": [0.2, 0.8]})
    assert waves.mean == pytest.approx(0.5)
    assert waves.contrast == pytest.approx(0.3, rel=0.02)
    # The strongest ones run along the diagonals.
    strongest = waves.frequencies_per_mm[np.argmax(waves.variances)]
    assert 1 / np.hypot(*strongest) == pytest.approx(3.0 * np.sqrt(2))


def test_one_radiance_has_no_waves() -> None:
    assert waves_of({"kind": "uniform", "radiance": 0.3}).contrast == 0.0


@pytest.mark.parametrize("texture", [{"kind": "noise", "wavelength_mm": [3.0, 9.0]}])
def test_what_is_painted_has_the_waves_of_the_definition(texture: dict[str, Any]) -> None:
    """A raster of 170 x 140 mm has about 2000 independent waves: their variance scatters by 3 %, a root by 1.6 %."""
    item = Scene.from_dict(wall(texture=texture)).objects[0]
    formula, painted = waves_of(texture), measure_spectrum(item, 3, Path())
    assert painted.mean == pytest.approx(formula.mean, rel=0.01)
    assert painted.contrast == pytest.approx(formula.contrast, rel=0.05)
    for axis in (0, 1):
        # Bins of direction and of frequency add another per cent.
        assert gradient_of(painted, axis) == pytest.approx(gradient_of(formula, axis), rel=0.06)


def test_leaves_are_known_without_their_veins_only() -> None:
    known = analytic_spectra()["leaf"]
    assert not known.exact
    assert all(one.exact for kind, one in analytic_spectra().items() if kind != "leaf")


def test_dots_at_random_places_have_the_variance_of_campbells_theorem() -> None:
    """Dots exp(-r² / 2σ²), painted here one by one."""
    rng, sigma, density, side, step = np.random.default_rng(1), 0.2, 1.0, 40.0, 0.1
    at = np.arange(0.0, side, step)
    count = rng.poisson(density * side**2)
    total = np.zeros((len(at), len(at)))
    for x, y in rng.uniform(0, side, (count, 2)):
        total += np.outer(np.exp(-((at - y) ** 2) / (2 * sigma**2)), np.exp(-((at - x) ** 2) / (2 * sigma**2)))
    texture = {
        "kind": "leaf",
        "mottling_contrast": 0.0,
        "speckle_density_per_mm2": density,
        "mean": 0.4,
        "vein_contrast": 0.0,
    }
    texture |= {"speckle_size_mm": 2.354820045 * sigma, "speckle_contrast": 0.5, "underside_lightness": 1.0}
    leaf = {"kind": "leaf", "length_mm": 40, "width_mm": 30}
    waves = waves_of(texture, mesh=leaf)
    # 1600 dots: their number scatters by 2.5 %, the standard deviation by half of that and more where dots meet.
    assert waves.contrast == pytest.approx(0.4 * 0.5 * total.std(), rel=0.05)
