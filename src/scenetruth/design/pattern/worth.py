"""What a pattern is worth to a rig: gradients in its images, and the noise of depth and motion that follows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound import Envelope, envelope_of
from scenetruth.design.pattern.errors import PatternError
from scenetruth.design.pattern.levels import Level, level_at, level_of
from scenetruth.design.pattern.make import Pattern, pattern_kinds
from scenetruth.design.pattern.picture import grey_values, without_shading
from scenetruth.design.pattern.rig import Rig
from scenetruth.design.pattern.spectrum import Figures, Spectrum, figures_of, seen_patch, spectrum_of
from scenetruth.errors import Problem

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["UNITS", "Worth", "figures_by_size", "pattern_worth", "theory_of", "worths_to_frame"]

Array = NDArray[np.float64]

# The part of a pattern that is looked at, in px, and points per px.
_PATCH_PX, _PARTS = 320, 4
# Pixels that are pictured.
_SHOWN_PX = 64
# Of a picture, in px of the rig: fewer of them tell nothing.
_LEAST_PX = 24
# Raster of theory: so many points, at least so many px or lengths along each side.
_COUNT, _THEORY_PX, _THEORY_LENGTHS = 1024, 256, 12


@dataclass(frozen=True, eq=False)
class Worth:
    """What a pattern is worth to a rig. Grey values are shares of full scale.

    Parameters
    ----------
    label
        What it is.
    mean
        Mean grey value.
    contrast
        Standard deviation of the grey values.
    gradient_x, gradient_y
        Rms of their derivatives, per px.
    theory_gradient
        The same of one axis from the pattern's closed form; None if there is none.
    wavelength_px
        Of the wave with the same contrast and gradient.
    size_px
        Size of speckles: full width at half maximum of the image's autocorrelation.
    aliased_share
        Share of the variance in waves too short for the pixels.
    noise_std
        Noise of the images.
    window_sigma_px
        Standard deviation of the window behind the figures that follow.
    disparity_px, depth_mm, slope, flow_px, velocity_lateral_mm, velocity_depth_mm, growth_rate
        Least standard deviations, as of `scenetruth.bound.Envelope`; None where the rig does not tell them.
    spectrum
        The pattern's spectrum in grey values, before lens and pixels if ``optics`` is set.
    optics
        The rig whose lens and pixels act on it; None if they have already.
    patch
        Grey values of some pixels in its middle, shape (y, x), without noise of a pattern.

    See Also
    --------
    scenetruth.design.pattern.pattern_worth : Makes it.
    scenetruth.bound.Envelope : The same standard deviations, from a gradient.

    Examples
    --------
    >>> from scenetruth.design.pattern import make_pattern, pattern_worth, rig_of
    >>> rig = rig_of(focal_length_px=2500, distance_mm=500, baseline_mm=5, positions=5)
    >>> worth = pattern_worth(make_pattern(rig, size_mm=(20, 20), seed=1))
    >>> f"speckles of {worth.size_px:.1f} px, gradients of {worth.gradient:.2f} per px, noise {worth.noise_std:.2f}"
    'speckles of 2.3 px, gradients of 0.31 per px, noise 0.01'
    >>> f"depth to {worth.depth_mm:.3f} mm; {100 * worth.aliased_share:.0f} % too fine for the pixels"
    'depth to 0.010 mm; 1 % too fine for the pixels'

    One frame tells nothing of motion, and dots that keep apart have no closed form:

    >>> [name for name, value in worth.figures().items() if value is None]
    ['theory_gradient', 'flow_px', 'velocity_lateral_mm', 'velocity_depth_mm', 'growth_rate']
    """

    label: str
    mean: float
    contrast: float
    gradient_x: float
    gradient_y: float
    theory_gradient: float | None
    wavelength_px: float
    size_px: float
    aliased_share: float
    noise_std: float
    window_sigma_px: float
    disparity_px: float | None
    depth_mm: float | None
    slope: float | None
    flow_px: float | None
    velocity_lateral_mm: float | None
    velocity_depth_mm: float | None
    growth_rate: float | None
    spectrum: Spectrum
    optics: Rig | None
    patch: Array

    @property
    def gradient(self) -> float:
        """Rms of the derivative along one axis, mean square of both, per px."""
        return math.hypot(self.gradient_x, self.gradient_y) / math.sqrt(2)

    def figures(self) -> dict[str, float | None]:
        """Return all numbers by name, None where nothing is known."""
        left_out = ("label", "spectrum", "optics", "patch")
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name not in left_out}


def pattern_worth(
    pattern: Pattern | str | Path | NDArray[Any],
    rig: Rig | None = None,
    *,
    mm_per_px: float | None = None,
    encoding: str = "srgb",
    picture_noise_std: float | None = None,
    window_sigma_px: float = 6.0,
    motion: str = "rigid",
    label: str | None = None,
) -> Worth:
    """Tell what a pattern, or a photograph of one, is worth to a rig.

    Parameters
    ----------
    pattern
        The pattern, or a photograph: an image file, or an array of grey values as of `make_recording`.
    rig
        The rig; that which the pattern was made for if not given.
    mm_per_px
        Of a photograph: the size of its pixels on the surface. Not given, it was taken by the rig's own camera at its
        distance, and lens and pixels have acted already.
    encoding
        Of a photograph: ``"srgb"``, as cameras write JPEG files, or ``"linear"``. What it shows as 1 is a perfectly
        white surface; in a picture by the rig's own camera, full scale.
    picture_noise_std
        Of a photograph: standard deviation of its noise, as a share of full scale. Not given, it has the rig's noise if
        the rig's camera took it, and none otherwise.
    window_sigma_px
        Standard deviation of the Gaussian window in which depth and motion are found.
    motion
        What is known of the motion, as of `scenetruth.bound.cramer_rao`.
    label
        What it is called; the pattern's kind or the file's name if not given.

    Returns
    -------
    Worth
        Its figures.

    Raises
    ------
    PatternError
        If the picture cannot be used, or a number is impossible.

    See Also
    --------
    scenetruth.design.pattern.make_pattern : A pattern for a rig.
    scenetruth.bound.envelope_of : Standard deviations from a gradient that is known already.

    Examples
    --------
    Dots of 4 and of 8 px, and a photograph of waves of 0.8 mm, whose pixels are 0.05 mm on the surface:

    >>> import numpy as np
    >>> from scenetruth.design.pattern import make_pattern, pattern_worth, rig_of
    >>> rig = rig_of(focal_length_px=2500, distance_mm=500, baseline_mm=5, positions=5)
    >>> for dot_px in (4, 8):
    ...     worth = pattern_worth(make_pattern(rig, dot_px=dot_px, size_mm=(20, 20), seed=1))
    ...     print(f"dots of {dot_px} px: depth to {worth.depth_mm:.4f} mm")
    dots of 4 px: depth to 0.0104 mm
    dots of 8 px: depth to 0.0140 mm
    >>> x, y = np.meshgrid(np.arange(300) * 0.05, np.arange(300) * 0.05)
    >>> picture = 0.5 + 0.2 * np.sin(2 * np.pi * x / 0.8) * np.sin(2 * np.pi * y / 0.8)
    >>> worth = pattern_worth(picture, rig, mm_per_px=0.05, encoding="linear")
    >>> f"{worth.label}: depth to {worth.depth_mm:.4f} mm"
    'picture: depth to 0.0254 mm'
    """
    if isinstance(pattern, Pattern):
        rig = rig or pattern.rig
        shown = _of_pattern(pattern, rig)
        return _worth(label or pattern.model.kind, shown, rig, theory_of(pattern, rig), window_sigma_px, motion)
    if rig is None:
        raise PatternError([Problem("rig", "is missing: a photograph does not tell for which camera")])
    _refuse_numbers(mm_per_px, picture_noise_std)
    grey = grey_values(pattern, encoding)
    name = label or (Path(pattern).name if isinstance(pattern, str | Path) else "picture")
    pitch = 1.0 if mm_per_px is None else mm_per_px / rig.mm_per_px
    if min(grey.shape) * pitch < _LEAST_PX:
        message = f"shows less than {_LEAST_PX} px of the rig's image along a side: take a larger picture"
        told = " x ".join(f"{side * pitch:.3g}" for side in reversed(grey.shape)) + " px"
        raise PatternError([Problem("picture", message, told)])
    if pitch > 1:
        message = f"is coarser than the rig sees, {rig.mm_per_px:.4g} mm per px: take a picture from nearer by"
        raise PatternError([Problem("mm_per_px", message, mm_per_px)])
    if grey.mean() <= 0:
        raise PatternError([Problem("picture", "is black", name)])
    if mm_per_px is not None:
        shown = _lit(without_shading(grey), rig, pitch, noise_std=picture_noise_std or 0.0)
    else:
        level = level_of(rig, float(grey.mean()))
        noise = level.noise_std if picture_noise_std is None else picture_noise_std
        shown = _Shown(without_shading(grey), level, 1.0, None, noise_std=noise)
    return _worth(name, shown, rig, None, window_sigma_px, motion)


@dataclass(frozen=True, eq=False)
class _Shown:
    """Grey values of a pattern: their distance on the sensor, the rig that acts on them, and what spoils them."""

    grey: Array
    level: Level
    pitch_px: float
    optics: Rig | None
    texel_px: float = 0.0
    noise_std: float = 0.0


def theory_of(pattern: Pattern, rig: Rig) -> Figures | None:
    """Return what a rig sees of a pattern from its closed form; None if it has none."""
    model = pattern.model
    side_mm = max(_THEORY_PX * rig.mm_per_px, _THEORY_LENGTHS * model.coarsest_mm)
    power = model.power(_COUNT, side_mm / _COUNT)
    if power is None:
        return None
    return figures_of(Spectrum(power * _range(pattern, rig) ** 2, side_mm / _COUNT / rig.mm_per_px), rig)


def figures_by_size(rig: Rig, sizes_px: Sequence[float], coverage: float = 0.5) -> dict[float, Figures]:
    """Return what a rig sees of random dots of several diameters, from the closed form of dots that lie anywhere.

    Parameters
    ----------
    rig
        The rig.
    sizes_px
        Diameters in px.
    coverage
        Share of the sheet that they cover.

    Returns
    -------
    dict
        What it sees, in shares of the range from ink to paper, by diameter.
    """
    found: dict[float, Figures] = {}
    for size in sizes_px:
        side, count = max(_THEORY_PX / 2, _THEORY_LENGTHS * size), _COUNT // 2
        dots = pattern_kinds()["speckle"].model_validate(
            {"kind": "speckle", "dot_mm": size, "coverage": coverage, "spacing": 0.0}
        )
        power = dots.power(count, side / count)
        assert power is not None
        found[size] = figures_of(Spectrum(power, side / count), rig)
    return found


def worths_to_frame(worths: Sequence[Worth]) -> pd.DataFrame:
    """Return the figures of several patterns beside each other.

    Parameters
    ----------
    worths
        The patterns.

    Returns
    -------
    pandas.DataFrame
        Columns ``pattern``, ``quantity``, ``value`` and ``unit``; quantities are the fields of `Worth`.
    """
    import pandas as pd

    rows = [
        {"pattern": worth.label, "quantity": name, "value": value, "unit": UNITS[name]}
        for worth in worths
        for name, value in worth.figures().items()
    ]
    return pd.DataFrame(rows).astype({"value": float})


UNITS = {
    "mean": "of full scale",
    "contrast": "of full scale",
    "gradient_x": "of full scale per px",
    "gradient_y": "of full scale per px",
    "theory_gradient": "of full scale per px",
    "wavelength_px": "px",
    "size_px": "px",
    "aliased_share": "1",
    "noise_std": "of full scale",
    "window_sigma_px": "px",
    "disparity_px": "px/step",
    "depth_mm": "mm",
    "slope": "1",
    "flow_px": "px/frame",
    "velocity_lateral_mm": "mm/frame",
    "velocity_depth_mm": "mm/frame",
    "growth_rate": "1/frame",
}
"""Units of the figures."""


def _range(pattern: Pattern, rig: Rig) -> float:
    """Return the step from ink to paper, as a share of full scale."""
    ink, paper = pattern.model.radiances
    return (paper - ink) * rig.light * level_at(rig, (paper + ink) / 2 * rig.light).gain


def _of_pattern(pattern: Pattern, rig: Rig) -> _Shown:
    """Return the grey values of the middle of a pattern."""
    sides_px = [min(side / rig.mm_per_px, _PATCH_PX) for side in pattern.size_mm]
    if min(sides_px) < _LEAST_PX:
        message = f"is less than {_LEAST_PX} px of the rig's image along a side: make a larger pattern"
        raise PatternError([Problem("size_mm", message, pattern.size_mm)])
    columns, rows = (int(side) * _PARTS for side in sides_px)
    width, height = (count / _PARTS * rig.mm_per_px for count in (columns, rows))
    box = ((pattern.size_mm[0] - width) / 2, (pattern.size_mm[1] - height) / 2, width, height)
    shown = _lit(pattern.radiance(box, (rows, columns)).astype(np.float64), rig, 1 / _PARTS, texel_px=1 / _PARTS)
    brightest = float(shown.grey.max())
    if brightest > 1:
        message = f"saturates the sensor: paper would be at {100 * brightest:.0f} % of full scale; lower it, or expose"
        raise PatternError([Problem("light", f"{message} for a shorter time", rig.light)])
    return shown


def _lit(reflectance: Array, rig: Rig, pitch_px: float, texel_px: float = 0.0, noise_std: float = 0.0) -> _Shown:
    """Return the grey values of a surface whose reflectance is known."""
    level = level_at(rig, float(reflectance.mean()) * rig.light)
    if level.gain <= 0:
        message = "gives a grey value that does not follow the light: the sensor is saturated; lower it"
        raise PatternError([Problem("light", message, rig.light)])
    grey = level.grey + level.gain * rig.light * (reflectance - reflectance.mean())
    return _Shown(grey, level, pitch_px, rig, texel_px, noise_std * level.gain * rig.light)


def _worth(label: str, shown: _Shown, rig: Rig, theory: Figures | None, window_sigma_px: float, motion: str) -> Worth:
    spectrum = spectrum_of(shown.grey, shown.pitch_px, shown.noise_std)
    seen = figures_of(spectrum, shown.optics, shown.texel_px)
    noise = shown.level.noise_std
    both = math.hypot(seen.gradient_x, seen.gradient_y)
    return Worth(
        label=label,
        mean=float(shown.grey.mean()),
        contrast=seen.contrast,
        gradient_x=seen.gradient_x,
        gradient_y=seen.gradient_y,
        theory_gradient=None if theory is None else theory.gradient_x,
        wavelength_px=2 * math.pi * seen.contrast / both if both > 0 else math.inf,
        size_px=seen.size_px,
        aliased_share=seen.aliased_share,
        noise_std=noise,
        window_sigma_px=window_sigma_px,
        spectrum=spectrum,
        optics=shown.optics,
        patch=seen_patch(shown.grey, shown.pitch_px, shown.optics, _SHOWN_PX),
        **_precision(rig, seen, noise, window_sigma_px, motion),
    )


def _precision(rig: Rig, seen: Figures, noise: float, window_sigma_px: float, motion: str) -> dict[str, float | None]:
    """Return the least standard deviations; None where the rig or a sensor without noise does not tell them."""
    names = [field.name for field in fields(Envelope)]
    if noise == 0 or rig.positions < 2 or min(seen.gradient_x, seen.gradient_y) <= 0:
        return dict.fromkeys(names)
    # Disparities are along x; what shows along both axes has the mean of both.
    along, mean = (
        asdict(
            envelope_of(
                focal_length_px=rig.focal_length_px,
                baseline_mm=rig.baseline_mm or 1.0,
                positions=rig.positions,
                frames=rig.frames,
                depth_mm=rig.distance_mm,
                gradient=gradient,
                noise_std=noise,
                window_sigma_px=window_sigma_px,
                motion=motion,  # type: ignore[arg-type]
            )
        )
        for gradient in (seen.gradient_x, math.hypot(seen.gradient_x, seen.gradient_y) / math.sqrt(2))
    )
    found = {name: (along if name in ("disparity_px", "depth_mm", "slope") else mean)[name] for name in names}
    if rig.baseline_mm is None:
        found |= dict.fromkeys(("depth_mm", "slope", "velocity_depth_mm", "growth_rate"))
    return {name: value if value is not None and math.isfinite(value) else None for name, value in found.items()}


def _refuse_numbers(mm_per_px: float | None, picture_noise_std: float | None) -> None:
    problems = []
    if mm_per_px is not None and not 0 < mm_per_px < math.inf:
        problems.append(Problem("mm_per_px", "must be a positive number", mm_per_px))
    if picture_noise_std is not None and not 0 <= picture_noise_std < 1:
        problems.append(Problem("picture_noise_std", "must be a share of full scale, from 0 on", picture_noise_std))
    if problems:
        raise PatternError(problems)
