"""Noise in ink and paper, and in shades of grey."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from scipy.stats import multivariate_normal, norm

from scenetruth.bound import texture_gradient
from scenetruth.design.patterns import generate_pattern
from scenetruth.design.patterns.pattern_model import GreyPicture, InkAreas, PatternError
from scenetruth.design.patterns.pattern_spectrum import PatternSpectrum, compute_pattern_statistics
from scenetruth.design.patterns.pattern_types import GreyNoisePattern, NoisePattern, compute_clipped_covariance
from tests.design.pattern.rigs import plain_rig

SIZE = (40.0, 30.0)


@settings(max_examples=20)
@given(correlation=some.floats(-0.95, 0.95), threshold=some.floats(-1.5, 1.5))
def test_noise_that_is_cut_has_the_covariance_of_two_thresholds(correlation: float, threshold: float) -> None:
    both = multivariate_normal([0, 0], [[1, correlation], [correlation, 1]]).cdf([threshold, threshold])
    found = compute_clipped_covariance(np.array([correlation]), threshold)[0]
    # The integral of scipy is good to 1e-5.
    assert found == pytest.approx(both - norm.cdf(threshold) ** 2, abs=3e-5)


def test_the_ends_of_that_covariance() -> None:
    for threshold in (0.0, 0.5, -1.0):
        share = norm.cdf(threshold)
        assert compute_clipped_covariance(np.array([1.0]), threshold)[0] == pytest.approx(share * (1 - share), rel=1e-6)
    np.testing.assert_allclose(compute_clipped_covariance(np.array([0.0, 0.5]), 0.0), [0.0, 1 / 12])


def test_the_closed_form_of_grey_noise_is_that_of_textures() -> None:
    """Without lens and pixels, at 16 to 64 px: there the spline's derivative is exact to 1e-6.

    The band of a raster of 1024 px differs a little from a ring: 0.5 %.
    """
    for exponent in (0.0, -2.0):
        model = GreyNoisePattern(kind="grey_noise", wavelength_mm=(16.0, 64.0), spectrum_exponent=exponent)
        found = compute_pattern_statistics(PatternSpectrum(model.power(1024, 1.0), 1.0), None)
        assert found.contrast == pytest.approx(0.2, rel=1e-9)
        assert found.gradient_x == pytest.approx(texture_gradient(0.2, (16.0, 64.0), exponent), rel=5e-3)
        assert found.aliased_share == 0.0


@pytest.mark.parametrize("coverage", [0.3, 0.7])
def test_outlines_hold_the_ink(coverage: float) -> None:
    pattern = generate_pattern(plain_rig(), "noise", size_mm=SIZE, wavelength_mm=(1.5, 6.0), seed=2, coverage=coverage)
    box = (5.0, 3.0, 30.0, 20.0)
    marks = pattern.marks(box)
    assert isinstance(marks, InkAreas)
    # Shoelace; holes count with the other sign.
    areas = [0.5 * np.sum(p[:, 0] * np.roll(p[:, 1], -1) - np.roll(p[:, 0], -1) * p[:, 1]) for p in marks.outlines_mm]
    assert (min(areas) < 0 < max(areas)) == (coverage > 0.5)
    share = abs(sum(areas)) / (box[2] * box[3])
    # Straight pieces of an eighth of the shortest wave cut off some of what bends: 2 % of these islands, and lakes.
    assert share == pytest.approx(pattern.drawing.ink(box, (400, 600)).mean(), abs=0.008)
    # 20 x 13 longest waves: a share is known to about 2 %.
    assert share == pytest.approx(coverage, abs=0.06)


def test_shades_of_grey_are_srgb_of_what_is_painted() -> None:
    pattern = generate_pattern(plain_rig(), "grey_noise", size_mm=SIZE, wavelength_mm=(1.5, 6.0), seed=2)
    marks = pattern.marks((0, 0, *SIZE))
    assert isinstance(marks, GreyPicture)
    values = marks.values / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    # White is paper, of 0.85.
    seen = pattern.radiance((0, 0, *SIZE), values.shape)
    np.testing.assert_allclose(0.85 * linear, seen, atol=0.004)
    assert seen.std() == pytest.approx(0.2 * 0.8, rel=0.05)
    assert seen.min() >= 0.05 - 1e-6
    assert seen.max() <= 0.85 + 1e-6


def test_what_cannot_be_is_told() -> None:
    with pytest.raises(PatternError, match=r"wavelength_mm: must be .shortest, longest."):
        generate_pattern(plain_rig(), "noise", size_mm=SIZE, wavelength_px=(20, 5))
    with pytest.raises(PatternError, match="so narrow a band"):
        generate_pattern(plain_rig(), "noise", size_mm=(50.0, 47.0), wavelength_mm=(5.2, 5.2000001))
    with pytest.raises(PatternError, match="too short for a sheet of this size"):
        generate_pattern(plain_rig(), "grey_noise", size_mm=(5000, 5000))
    with pytest.raises(PatternError, match="contrast"):
        generate_pattern(plain_rig(), "grey_noise", size_mm=SIZE, contrast=0.5)


def test_the_model_tells_what_it_is() -> None:
    model = NoisePattern(kind="noise", wavelength_mm=(1.0, 4.0))
    assert model.told(0.2) == (
        "noise of wavelengths 1.000 to 4.000 mm (5.00 to 20.00 px), cut into ink and paper, 50 % covered"
    )
