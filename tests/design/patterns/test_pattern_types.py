"""Dots and noise in ink and paper: where ink lies, what it covers, and the spectrum that theory gives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some
from scipy.spatial import cKDTree
from scipy.special import j1
from scipy.stats import multivariate_normal, norm

from scenetruth.bound import texture_gradient
from scenetruth.design.patterns import (
    GreyNoisePattern,
    GreyPicture,
    InkAreas,
    InkDots,
    NoisePattern,
    Pattern,
    PatternSpectrum,
    SpecklePattern,
    compute_boolean_covariance,
    compute_clipped_covariance,
    compute_pattern_statistics,
    generate_pattern,
)
from scenetruth.errors import ArgumentError
from tests.helpers.pattern_rigs import plain_rig

SIZE = (40.0, 30.0)


def dots_of(pattern: Pattern) -> InkDots:
    marks = pattern.marks((0.0, 0.0, *pattern.size_mm))
    assert isinstance(marks, InkDots)
    return marks


@settings(max_examples=15)
@given(
    seed=some.integers(0, 2**63 - 1),
    spacing=some.sampled_from([0.0, 0.5, 0.8, 1.0, 1.2]),
    share=some.floats(0.1, 1.0),
    dot_mm=some.floats(0.5, 1.5),
)
def test_dots_keep_apart_and_cover_what_they_should(seed: int, spacing: float, share: float, dot_mm: float) -> None:
    coverage = share * (0.34 if spacing > 1 else 0.5)
    pattern = generate_pattern(
        plain_rig(), "speckle", size_mm=SIZE, seed=seed, dot_mm=dot_mm, coverage=coverage, spacing=spacing
    )
    centres = dots_of(pattern).centres_mm
    tree = cKDTree(centres)
    nearest = tree.query(centres, k=2)[0][:, 1] if len(centres) > 1 else np.array([np.inf])
    assert nearest.min() >= spacing * dot_mm * (1 - 1e-12)
    # An independent count: points on a fine grid. The kernel counts on a grid of D / 16, so that borders of dots,
    # 4 / D per covered area, are off by a small share of that; one dot more or less adds its own area.
    x, y = np.meshgrid(np.linspace(0, SIZE[0], 400), np.linspace(0, SIZE[1], 300))
    covered = tree.query(np.stack([x.ravel(), y.ravel()], axis=-1))[0] <= dot_mm / 2
    assert covered.mean() == pytest.approx(coverage, abs=0.01 + dot_mm**2 / 1200)
    # What is drawn is what is there.
    assert pattern.drawing.ink((0, 0, *SIZE), (300, 400)).mean() == pytest.approx(covered.mean(), abs=0.01)


def test_a_seed_is_a_pattern() -> None:
    one, same, other = (
        dots_of(generate_pattern(plain_rig(), size_mm=SIZE, seed=seed)).centres_mm for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one[:50], other[:50])


def test_px_of_the_sensor_become_mm() -> None:
    pattern = generate_pattern(plain_rig(), size_mm=SIZE, dot_px=5)
    assert isinstance(pattern.model, SpecklePattern)
    assert pattern.model.dot_mm == pytest.approx(5 * 400 / 2000)
    assert "dots of 1.000 mm (5.00 px)" in pattern.description
    assert generate_pattern(plain_rig(image_size_px=(90, 60)), dot_mm=0.5).size_mm == (20.0, 14.0)


def test_dots_that_lie_anywhere_have_the_covariance_of_a_boolean_model() -> None:
    at = np.array([0.0, 0.3, 1.0, 2.0])
    for coverage in (0.05, 0.5, 0.8):
        found = compute_boolean_covariance(at, 1.0, coverage)
        assert found[0] == pytest.approx(coverage * (1 - coverage))
        np.testing.assert_array_equal(found[2:], 0.0)
    # Few dots do not overlap: their spectrum is that of a disc, n (D J1(π D f) / 2 f)², but for pairs, a share of about
    # the coverage.
    coverage, count, pitch = 1e-4, 512, 1 / 32
    power = SpecklePattern(kind="speckle", dot_mm=1.0, coverage=coverage, spacing=0.0).power(count, pitch)
    assert power is not None
    frequency = np.fft.fftfreq(count, pitch)[1:40]
    density = power[0, 1:40] * (count * pitch) ** 2
    disc = coverage * 4 / np.pi * (j1(np.pi * frequency) / (2 * frequency)) ** 2
    # Sharp rims alias on a raster of D / 32: a few thousandths of the spectrum at 0.
    np.testing.assert_allclose(density, disc, atol=0.002 * disc[0])


def test_a_sheet_covers_as_its_covariance_says() -> None:
    """The drawing's own covariance against theory.

    60 x 45 diameters hold some 1000 independent pieces, which tell it to 3 % of the variance, 0.25.
    """
    pattern = generate_pattern(plain_rig(), "speckle", size_mm=(60.0, 45.0), dot_mm=1.0, spacing=0.0, seed=4)
    ink = pattern.drawing.ink((0, 0, 60, 45), (450, 600)).astype(float)
    ink -= ink.mean()
    lags = [3, 6, 12]
    found = [np.mean(ink[:, : 600 - lag] * ink[:, lag:]) for lag in lags]
    expected = compute_boolean_covariance(np.array(lags) / 10, 1.0, 0.5)
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_dots_that_cannot_be_are_told() -> None:
    with pytest.raises(ArgumentError, match=r"coverage: exceeds the maximum .* 0\.50; reduce coverage or spacing"):
        generate_pattern(plain_rig(), size_mm=SIZE, coverage=0.7)
    with pytest.raises(ArgumentError, match=r"dot_mm: requires .* dots .* use a smaller one"):
        generate_pattern(plain_rig(), size_mm=(2000, 2000), dot_px=1)
    with pytest.raises(ArgumentError, match=r"(?s)4 problems.*coverage.*dots: unknown key.*size_mm.*seed"):
        generate_pattern(plain_rig(), size_mm=(-1, 3), coverage=2, dots=3, seed=-1)
    with pytest.raises(ArgumentError, match="type: must be one of grey_noise, noise, speckle"):
        generate_pattern(plain_rig(), "stripes", size_mm=SIZE)
    with pytest.raises(ArgumentError, match="size_mm: is missing"):
        generate_pattern(plain_rig())
    with pytest.raises(ArgumentError, match="size_mm: must be at least 8 times 10 mm"):
        generate_pattern(plain_rig(), size_mm=(50, 200), dot_mm=10)
    with pytest.raises(ArgumentError, match=r"(?s)specify either dot_px or dot_mm.*ink must be darker"):
        generate_pattern(plain_rig(), size_mm=SIZE, dot_mm=1, dot_px=3, radiances=(0.9, 0.1))
    with pytest.raises(ArgumentError, match="dot_px: must be a number"):
        generate_pattern(plain_rig(), size_mm=SIZE, dot_px="large")


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


def test_noise_that_cannot_be_is_told() -> None:
    with pytest.raises(ArgumentError, match=r"wavelength_mm: must be .shortest, longest."):
        generate_pattern(plain_rig(), "noise", size_mm=SIZE, wavelength_px=(20, 5))
    with pytest.raises(ArgumentError, match="contains no wavelength"):
        generate_pattern(plain_rig(), "noise", size_mm=(50.0, 47.0), wavelength_mm=(5.2, 5.2000001))
    with pytest.raises(ArgumentError, match="too short for a sheet of this size"):
        generate_pattern(plain_rig(), "grey_noise", size_mm=(5000, 5000))
    with pytest.raises(ArgumentError, match="contrast"):
        generate_pattern(plain_rig(), "grey_noise", size_mm=SIZE, contrast=0.5)


def test_the_model_tells_what_it_is() -> None:
    model = NoisePattern(kind="noise", wavelength_mm=(1.0, 4.0))
    assert model.description(0.2) == (
        "noise of wavelengths 1.000 to 4.000 mm (5.00 to 20.00 px), thresholded to ink and paper, 50 % covered"
    )
