"""Images of star 5: those of the challenge, as they come with pyvale, and rendered ones of star5.yaml.

The image at rest of the challenge does not come with pyvale. Two images at rest are made from a reference: the
reference without its noise (Wiener filter of the mean spectrum over directions), and twice noise of the level of the
reference itself, whose variance is linear in the grey value. What the filter leaves of the noise belongs to the pattern
of both images: it raises the variance of the vertical gradient by less than 1 %.
"""

from __future__ import annotations

from math import comb
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, map_coordinates

import scenetruth as st
from benchmarks.dic_challenge.rules import STRAIN as STRAIN_AMPLITUDE
from benchmarks.dic_challenge.rules import periods_px

__all__ = [
    "BAND_PX",
    "PAIRS",
    "SCENE",
    "STRAIN",
    "band_of",
    "given_pair",
    "images_at_rest",
    "noise_of",
    "recording_of",
    "rendered_pair",
    "strain_field",
    "strain_pair",
    "without_noise",
]

PAIRS = ("given", "given_at_rest", "rendered", "rendered_at_rest", "given_strain", "rendered_strain")
SCENE = Path(__file__).with_name("star5.yaml")
BAND_PX = 40
"""Rows above and below the centre row that methods see."""
RENDERED_BAND = (
    "camera.height=121",
    "objects.0.mesh.size_mm=[402.05, 14.05]",
    "objects.0.mesh.resolution_mm=0.05",
)
"""The middle of the scene with triangles of half a pixel, whose vertices lie between the centres of pixels."""
STRAIN = (
    "camera.height=61",
    "objects.0.mesh.size_mm=[402.05, 8.05]",
    "objects.0.deformation.0="
    "{kind: star_strain, strain: {kind: linear, rate_per_frame: 0.05}, period_mm: [0.9220625, 30.0706875]}",
)
"""Star 6 of the challenge, whose images do not come with pyvale: strain of 5 % at every period."""
_LIMITS = st.Limits(vertices=3e6)
_FILES = ("DIC_Challenge_Star_Noise_Ref.tiff", "DIC_Challenge_Star_Noise_Def.tiff")
# Differences of this order pass the highest frequencies alone, where the speckles have no power.
_ORDER = 10
_QUANTISATION = 1 / 12
_RINGS = 60

Image = NDArray[np.float64]


def given_pair(data: Path) -> tuple[Image, Image]:
    """Return the reference and the moved image of the challenge, grey values of 8 bits.

    Parameters
    ----------
    data
        Folder ``data/dic/challenge`` of pyvale.
    """
    import imageio.v3 as iio

    first, second = (np.asarray(iio.imread(data / name), dtype=np.float64) for name in _FILES)
    return first, second


def noise_of(image: Image) -> tuple[float, float]:
    """Return slope and offset of the variance of white noise over the grey value, quantisation included."""
    weights = np.array([(-1) ** place * comb(_ORDER, place) for place in range(_ORDER + 1)], dtype=np.float64)
    weights /= np.sqrt(weights @ weights)
    high = correlate1d(correlate1d(image, weights, axis=0), weights, axis=1)[_ORDER:-_ORDER, _ORDER:-_ORDER]
    # The mean square of the differences is the variance averaged with the squared weights.
    grey = correlate1d(correlate1d(image, weights**2, axis=0), weights**2, axis=1)[_ORDER:-_ORDER, _ORDER:-_ORDER]
    slope, offset = np.polyfit(grey.ravel(), np.square(high).ravel(), 1)
    return float(slope), float(offset)


def without_noise(image: Image, variance: float) -> Image:
    """Return an image without white noise of a variance: Wiener filter of its spectrum over rings of frequency."""
    height, width = image.shape
    mirrored = np.block([[image, image[:, ::-1]], [image[::-1], image[::-1, ::-1]]])
    spectrum = np.fft.rfft2(mirrored - mirrored.mean())
    frequency = np.hypot(np.fft.fftfreq(2 * height)[:, None], np.fft.rfftfreq(2 * width))
    ring = np.minimum((frequency * (2 * _RINGS)).astype(int), 2 * _RINGS)
    power = np.bincount(ring.ravel(), np.abs(spectrum).ravel() ** 2) / np.bincount(ring.ravel()) / mirrored.size
    kept = np.maximum(1 - variance / np.maximum(power, variance), 0.0)
    places = (np.arange(kept.size) + 0.5) / (2 * _RINGS)
    filtered = np.fft.irfft2(spectrum * np.interp(frequency, places, kept), mirrored.shape) + mirrored.mean()
    return np.asarray(filtered[:height, :width])


def images_at_rest(reference: Image, seed: int = 0) -> tuple[Image, Image]:
    """Return two images of the pattern of the reference, with noise of its level that is drawn twice, of 8 bits."""
    pattern = _pattern_of(reference)
    return _with_noise([pattern, pattern], noise_of(reference), seed)


def strain_pair(reference: Image, seed: int = 1) -> tuple[Image, Image]:
    """Return the pattern of the reference at rest and moved by the field of star 6, each with noise, of 8 bits.

    The moved image has at y + v the value that the pattern has at y, with the displacement v of `strain_field` along y,
    by splines of order 5.
    """
    pattern = _pattern_of(reference)
    rows, columns = np.indices(pattern.shape, dtype=np.float64)
    periods, centre = periods_px(columns), pattern.shape[0] // 2
    places = rows.copy()
    # v is a contraction along y by 5 %: each round adds more than a digit.
    for _ in range(15):
        places = rows - strain_field(places - centre, periods)
    moved = map_coordinates(pattern, [places, columns], order=5, mode="mirror")
    return _with_noise([pattern, moved], noise_of(reference), seed)


def strain_field(y_px: Image, periods: Image) -> Image:
    """Return the displacement of star 6 along y, px: its derivative along y has the amplitude 5 % at every period."""
    waves = 2 * np.pi / periods
    return np.asarray(STRAIN_AMPLITUDE / waves * np.sin(waves * y_px))


def _pattern_of(reference: Image) -> Image:
    slope, offset = noise_of(reference)
    return without_noise(reference, float(np.mean(slope * reference + offset)))


def _with_noise(patterns: list[Image], noise: tuple[float, float], seed: int) -> tuple[Image, Image]:
    """Return two patterns with noise whose variance is linear in the grey value, rounded to 8 bits."""
    generator, drawn = np.random.default_rng(seed), []
    for pattern in patterns:
        variance = np.maximum(noise[0] * pattern + noise[1] - _QUANTISATION, 0.0)
        drawn.append(np.rint(pattern + np.sqrt(variance) * generator.standard_normal(pattern.shape)))
    first, second = (np.clip(each, 0, 255) for each in drawn)
    return first, second


def rendered_pair(*changes: str) -> tuple[Image, Image, Image]:
    """Return both images of the rendered star, grey values of 8 bits, and the true displacement along y, px."""
    recording, truth = st.simulate(st.load_scene(SCENE, overrides=[*RENDERED_BAND, *changes]), limits=_LIMITS)
    first, second = (recording["image"].isel(s=0).sel(t=t).values.astype(np.float64) for t in (0, 1))
    scale = 255 / float(recording.attrs["full_scale"])
    return first * scale, second * scale, truth["flow"].isel(image_component=1).sel(t=0).values


def band_of(image: Image, rows: int = BAND_PX) -> Image:
    """Return the rows around the centre row."""
    centre = image.shape[0] // 2
    return image[max(0, centre - rows) : centre + rows + 1]


def recording_of(first: Image, second: Image) -> xr.Dataset:
    """Return two frames of one camera; lengths in mm have no meaning."""
    images = np.rint(np.stack([first, second])[None]).astype(np.uint8)
    return st.make_recording(images, focal_length_px=5000.0, baseline_mm=1.0)
