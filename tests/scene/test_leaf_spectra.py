"""Spectra of leaves against the plate model with the published coefficients, and the materials made of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expn

import scenetruth as st
from scenetruth.scene import LEAF_SPECTRA, LEAF_WAVELENGTHS_NM, BladeSpectrum, leaf_material

# Féret et al. (2017), coefficients of PROSPECT-D: refractive index, and specific absorption of chlorophyll,
# carotenoids (cm²/µg), water (1/cm) and dry matter (cm²/g).
COEFFICIENTS = {
    450: (1.4955, 0.0587747, 0.167441, 0.000114, 6.66),
    550: (1.4739, 0.00930939, 0.00418898, 0.000588, 2.3),
    660: (1.4468, 0.0474949, 0.0, 0.003791, 2.3),
    850: (1.4347, 0.0, 0.0, 0.04199, 2.3),
}


def mean_transmittance(index: float, largest_deg: float) -> float:
    """Return the Fresnel transmittance for isotropic light within a cone, by quadrature."""
    largest = np.deg2rad(largest_deg)

    def weighted(angle: float) -> float:
        inside = np.arcsin(np.sin(angle) / index)
        one, other = np.cos(angle), np.cos(inside)
        across = ((one - index * other) / (one + index * other)) ** 2
        along = ((index * one - other) / (index * one + other)) ** 2
        return float((1 - (across + along) / 2) * np.sin(2 * angle))

    return float(quad(weighted, 0, largest)[0] / np.sin(largest) ** 2)


def plates(spectrum: BladeSpectrum, wavelength: int) -> tuple[float, float]:
    """Return reflectance and transmittance of N plates (Stokes 1862, Allen et al. 1969, Jacquemoud and Baret 1990)."""
    index, *specific = COEFFICIENTS[wavelength]
    contents = spectrum.chlorophyll_ug_cm2, spectrum.carotenoids_ug_cm2, spectrum.water_cm, spectrum.dry_matter_g_cm2
    absorption = float(np.dot(specific, contents)) / spectrum.layers
    passed = 2 * float(expn(3, absorption))
    enters, from_all = mean_transmittance(index, 40.0), mean_transmittance(index, 90.0)
    leaves = from_all / index**2

    def plate(first: float) -> tuple[float, float]:
        through = first * passed * leaves / (1 - ((1 - leaves) * passed) ** 2)
        return 1 - first + (1 - leaves) * passed * through, through

    (r_top, t_top), (r, t) = plate(enters), plate(from_all)
    d = np.sqrt((1 + r + t) * (1 + r - t) * (1 - r + t) * (1 - r - t))
    a, b = (1 + r**2 - t**2 + d) / (2 * r), (1 - r**2 + t**2 + d) / (2 * t)
    n = spectrum.layers - 1
    whole = a * b**n - 1 / (a * b**n)
    r_below, t_below = (b**n - b**-n) / whole, (a - 1 / a) / whole
    between = 1 - r_below * r
    return r_top + t_top * r_below * t / between, t_top * t_below / between


@pytest.mark.parametrize("wavelength", COEFFICIENTS)
@pytest.mark.parametrize("name", LEAF_SPECTRA)
def test_spectra_are_those_of_the_plate_model(name: str, wavelength: int) -> None:
    spectrum, at = LEAF_SPECTRA[name], LEAF_WAVELENGTHS_NM.index(wavelength)
    reflectance, transmittance = plates(spectrum, wavelength)
    # Rounded to 1e-4.
    assert spectrum.reflectance[at] == pytest.approx(reflectance, abs=6e-5)
    assert spectrum.transmittance[at] == pytest.approx(transmittance, abs=6e-5)


@pytest.mark.parametrize("name", LEAF_SPECTRA)
def test_spectra_are_those_of_green_leaves(name: str) -> None:
    """Little light passes or returns in blue and red, more in green, and nearly all in the near infrared."""
    spectrum = LEAF_SPECTRA[name]
    reflectance = dict(zip(LEAF_WAVELENGTHS_NM, spectrum.reflectance, strict=True))
    transmittance = dict(zip(LEAF_WAVELENGTHS_NM, spectrum.transmittance, strict=True))
    assert max(reflectance[450], reflectance[675]) < 0.05 < reflectance[550] < 0.25
    assert reflectance[550] == max(reflectance[nm] for nm in LEAF_WAVELENGTHS_NM if nm <= 675)
    assert 0.4 < reflectance[850] < 0.5
    assert 0.4 < transmittance[850] < 0.55
    assert 0.9 < reflectance[850] + transmittance[850] < 1.0


def test_more_chlorophyll_absorbs_more() -> None:
    young, green, dark = (LEAF_SPECTRA[name] for name in ("young_leaf", "green_leaf", "dark_leaf"))
    assert young.chlorophyll_ug_cm2 < green.chlorophyll_ug_cm2 < dark.chlorophyll_ug_cm2
    for at, wavelength in enumerate(LEAF_WAVELENGTHS_NM):
        if wavelength <= 700:
            absorbed = [1 - each.reflectance[at] - each.transmittance[at] for each in (young, green, dark)]
            assert absorbed == sorted(absorbed)


@pytest.mark.parametrize("index", [1.0, 1.32, 1.4])
@pytest.mark.parametrize("name", LEAF_SPECTRA)
def test_boundary_and_leaf_have_the_spectrum_together(name: str, index: float) -> None:
    bands = {f"band_{nm}": nm for nm in LEAF_WAVELENGTHS_NM}
    material, spectrum = leaf_material(name, bands, refractive_index=index), LEAF_SPECTRA[name]
    at_boundary = ((index - 1) / (index + 1)) ** 2
    for at, nm in enumerate(LEAF_WAVELENGTHS_NM):
        diffuse, passed = material["reflectance"][f"band_{nm}"], material["transmittance"][f"band_{nm}"]
        assert at_boundary + (1 - at_boundary) * diffuse == pytest.approx(spectrum.reflectance[at], abs=6e-5)
        assert (1 - at_boundary) * passed == pytest.approx(spectrum.transmittance[at], abs=6e-5)
        assert diffuse >= 0
        assert diffuse + passed <= 1


def test_default_bands_are_four() -> None:
    assert list(leaf_material("green_leaf")["reflectance"]) == ["blue", "green", "red", "near_infrared"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "oak"}, r"name: must be one of young_leaf, green_leaf, dark_leaf \(got 'oak'\)"),
        ({"bands": {"red": 655}}, r"bands.red: must be one of 450, .* nm \(got 655\)"),
        ({"bands": {}}, r"bands: must be 1 to 16 \(got 0\)"),
        ({"refractive_index": 1.5}, r"refractive_index: must be from 1 to 1.4 \(got 1.5\)"),
    ],
)
def test_bad_input_is_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(st.ArgumentError, match=message):
        leaf_material(**{"name": "green_leaf", **arguments})
