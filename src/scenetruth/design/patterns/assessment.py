"""Assessment of a pattern for a rig: intensity gradients and predicted uncertainty, with summary text and plots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound import ClosedFormBound, closed_form_bound
from scenetruth.design.patterns.generation import Pattern, list_pattern_types
from scenetruth.design.patterns.pattern_rig import PatternGreyLevel, PatternRig, compute_grey_level, find_grey_level
from scenetruth.design.patterns.pattern_spectrum import (
    NYQUIST,
    PatternSpectrum,
    PatternStatistics,
    compute_pattern_statistics,
    compute_ring_means,
    compute_spectrum,
    load_grey_values,
    remove_shading,
    sample_patch,
)
from scenetruth.errors import ArgumentError, Problem
from scenetruth.number_format import format_two_digits
from scenetruth.results import QuantityValue, Result, refuse_unknown

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "PatternAssessment",
    "assess_pattern",
    "assessments_to_dataframe",
    "compute_size_table",
    "compute_theoretical_statistics",
    "describe_assessments",
    "describe_pattern",
    "plot_assessments",
]


Array = NDArray[np.float64]

_PATCH_PX, _PARTS = 320, 4  # assessed part of a pattern in px, and samples per px
_SHOWN_PX = 64  # size of the displayed part in px
_LEAST_PX = 24  # least size of a picture in px of the rig
# Raster of analytic spectra: number of points, least number of px, or of lengths, along each side.
_COUNT, _THEORY_PX, _THEORY_LENGTHS = 1024, 256, 12


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
"""Units of the numbers of an assessment, by name."""


@dataclass(frozen=True, eq=False)
class PatternAssessment(Result):
    """Assessment of a pattern for a rig. Grey values are relative to full scale.

    Parameters
    ----------
    label
        Name of the pattern.
    mean
        Mean grey value.
    contrast
        Standard deviation of the grey values.
    gradient_x, gradient_y
        RMS of the derivatives along x and y, per px.
    theory_gradient
        RMS derivative along one axis from the closed form of the pattern; None without a closed form.
    wavelength_px
        Wavelength of a wave with the same contrast and gradient.
    size_px
        Speckle size: full width at half maximum of the autocorrelation of the image.
    aliased_share
        Fraction of the variance beyond the Nyquist frequency.
    noise_std
        Standard deviation of the image noise.
    window_sigma_px
        Standard deviation of the analysis window for the following values.
    disparity_px, depth_mm, slope, flow_px, velocity_lateral_mm, velocity_depth_mm, growth_rate
        Lowest standard deviations, as in `scenetruth.bound.ClosedFormBound`; None where the rig does not measure them.
    spectrum
        Spectrum of the pattern in grey values, before blur by lens and pixels if ``optics`` is set.
    optics
        The rig whose lens and pixels are applied; None if the picture already includes them.
    patch
        Grey values of the central pixels, shape (y, x); without noise for a generated pattern. `save` omits
        ``spectrum``, ``optics`` and ``patch``: after `load` they are None, and the assessment cannot be plotted.

    See Also
    --------
    scenetruth.design.patterns.assess_pattern : Computes an assessment.
    scenetruth.bound.ClosedFormBound : The same standard deviations, from a gradient.

    Examples
    --------
    >>> from scenetruth.design.patterns import generate_pattern, assess_pattern, PatternRig
    >>> rig = PatternRig.from_scene(focal_length_px=2500, distance_mm=500, baseline_mm=5, positions=5)
    >>> worth = assess_pattern(generate_pattern(rig, size_mm=(20, 20), seed=1))
    >>> f"speckles of {worth.size_px:.1f} px, gradients of {worth.gradient:.2f} per px, noise {worth.noise_std:.2f}"
    'speckles of 2.3 px, gradients of 0.31 per px, noise 0.01'
    >>> f"depth to {worth.depth_mm:.3f} mm; {100 * worth.aliased_share:.0f} % too fine for the pixels"
    'depth to 0.010 mm; 1 % too fine for the pixels'

    One frame gives no motion, and dots with a least distance have no closed form:

    >>> [name for name, value in worth.statistics().items() if value is None]
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
    spectrum: PatternSpectrum | None = field(default=None, repr=False)
    optics: PatternRig | None = field(default=None, repr=False)
    patch: Array | None = field(default=None, repr=False)

    _UNSAVED = frozenset({"spectrum", "optics", "patch"})

    @property
    def gradient(self) -> float:
        """RMS derivative along one axis, averaged over both axes, per px."""
        return math.hypot(self.gradient_x, self.gradient_y) / math.sqrt(2)

    def statistics(self) -> dict[str, float | None]:
        """Return all numbers by name; None where they cannot be determined."""
        return {name: getattr(self, name) for name in UNITS}

    def value(self, quantity: str, statistic: str = "rmse", *, region: str = "all") -> QuantityValue:
        """Return one number with its unit.

        Parameters
        ----------
        quantity
            A field, for example ``depth_mm`` or ``contrast``.
        statistic, region
            ``rmse`` and ``all``, the only choices for a pattern.

        Raises
        ------
        ArgumentError
            If there is none; the message lists those that there are.
        """
        refuse_unknown(quantity=(quantity, UNITS), statistic=(statistic, ["rmse"]), region=(region, ["all"]))
        number = getattr(self, quantity)
        return QuantityValue(
            math.nan if number is None else number, UNITS[quantity], statistic=statistic, region=region
        )

    def to_dataframe(self) -> pd.DataFrame:
        """Return all numbers: columns ``pattern``, ``quantity``, ``value`` and ``unit``."""
        return assessments_to_dataframe([self])

    def summary(self) -> str:
        """Return the gradients, the standard deviations and the warnings, one per line."""
        return "\n".join(describe_assessments([self]))


def assess_pattern(
    pattern: Pattern | str | Path | NDArray[Any],
    rig: PatternRig | None = None,
    *,
    mm_per_px: float | None = None,
    encoding: str = "srgb",
    picture_noise_std: float | None = None,
    window_sigma_px: float = 6.0,
    motion: str = "rigid",
    label: str | None = None,
) -> PatternAssessment:
    """Assess a printed pattern or a photograph of one: contrast, gradient, predicted uncertainty.

    Parameters
    ----------
    pattern
        The pattern, or a photograph: an image file, or an array of grey values as in `make_recording`.
    rig
        The rig; default: the rig of the pattern.
    mm_per_px
        Pixel size of a photograph on the surface. By default, it was recorded by the camera of the rig at its distance,
        and includes blur by lens and pixels.
    encoding
        Encoding of a photograph: ``"srgb"``, as in JPEG files, or ``"linear"``. A value of 1 is a perfectly white
        surface; in a photograph by the camera of the rig, full scale.
    picture_noise_std
        Standard deviation of the noise of a photograph, relative to full scale. Default: the noise of the rig for a
        photograph by its camera, otherwise none.
    window_sigma_px
        Standard deviation of the Gaussian window in which depth and motion are estimated.
    motion
        Motion model, as in `scenetruth.bound.cramer_rao_bound`.
    label
        Name of the pattern; default: its type, or the name of the file.

    Returns
    -------
    PatternAssessment
        The assessment.

    Raises
    ------
    ArgumentError
        If the picture is not usable, or a number is invalid.

    See Also
    --------
    scenetruth.design.patterns.generate_pattern : Generates a pattern for a rig.
    scenetruth.bound.closed_form_bound : Standard deviations from a given gradient.

    Examples
    --------
    Dots of 4 and of 8 px, and a photograph of waves of 0.8 mm with pixels of 0.05 mm on the surface:

    >>> import numpy as np
    >>> from scenetruth.design.patterns import generate_pattern, assess_pattern, PatternRig
    >>> rig = PatternRig.from_scene(focal_length_px=2500, distance_mm=500, baseline_mm=5, positions=5)
    >>> for dot_px in (4, 8):
    ...     worth = assess_pattern(generate_pattern(rig, dot_px=dot_px, size_mm=(20, 20), seed=1))
    ...     print(f"dots of {dot_px} px: depth to {worth.depth_mm:.4f} mm")
    dots of 4 px: depth to 0.0104 mm
    dots of 8 px: depth to 0.0140 mm
    >>> x, y = np.meshgrid(np.arange(300) * 0.05, np.arange(300) * 0.05)
    >>> picture = 0.5 + 0.2 * np.sin(2 * np.pi * x / 0.8) * np.sin(2 * np.pi * y / 0.8)
    >>> worth = assess_pattern(picture, rig, mm_per_px=0.05, encoding="linear")
    >>> f"{worth.label}: depth to {worth.depth_mm:.4f} mm"
    'picture: depth to 0.0254 mm'
    """
    if isinstance(pattern, Pattern):
        rig = rig or pattern.rig
        shown = _render_pattern(pattern, rig)
        return _assess(
            label or pattern.model.kind,
            shown,
            rig,
            compute_theoretical_statistics(pattern, rig),
            window_sigma_px,
            motion,
        )
    if rig is None:
        raise ArgumentError(
            [Problem("rig", "is missing: the assessment of a photograph requires a rig")], source="a pattern"
        )
    _refuse_numbers(mm_per_px, picture_noise_std)
    grey = load_grey_values(pattern, encoding)
    name = label or (Path(pattern).name if isinstance(pattern, str | Path) else "picture")
    pitch = 1.0 if mm_per_px is None else mm_per_px / rig.mm_per_px
    if min(grey.shape) * pitch < _LEAST_PX:
        message = f"shows less than {_LEAST_PX} px of the rig's image along a side: use a larger picture"
        text = " x ".join(f"{side * pitch:.3g}" for side in reversed(grey.shape)) + " px"
        raise ArgumentError([Problem("picture", message, text)], source="a pattern")
    if pitch > 1:
        message = f"is coarser than the pixels of the rig, {rig.mm_per_px:.4g} mm per px: use a higher resolution"
        raise ArgumentError([Problem("mm_per_px", message, mm_per_px)], source="a pattern")
    if grey.mean() <= 0:
        raise ArgumentError([Problem("picture", "is black", name)], source="a pattern")
    if mm_per_px is not None:
        shown = _illuminate(remove_shading(grey), rig, pitch, noise_std=picture_noise_std or 0.0)
    else:
        level = find_grey_level(rig, float(grey.mean()))
        noise = level.noise_std if picture_noise_std is None else picture_noise_std
        shown = _ImagedPattern(remove_shading(grey), level, 1.0, None, noise_std=noise)
    return _assess(name, shown, rig, None, window_sigma_px, motion)


@dataclass(frozen=True, eq=False)
class _ImagedPattern:
    """Grey values of a pattern, their spacing on the sensor, the optics to apply, and their noise."""

    grey: Array
    level: PatternGreyLevel
    pitch_px: float
    optics: PatternRig | None
    texel_px: float = 0.0
    noise_std: float = 0.0


def compute_theoretical_statistics(pattern: Pattern, rig: PatternRig) -> PatternStatistics | None:
    """Return the image statistics of a pattern from its closed form; None without a closed form."""
    model = pattern.model
    side_mm = max(_THEORY_PX * rig.mm_per_px, _THEORY_LENGTHS * model.coarsest_mm)
    power = model.power(_COUNT, side_mm / _COUNT)
    if power is None:
        return None
    return compute_pattern_statistics(
        PatternSpectrum(power * _range(pattern, rig) ** 2, side_mm / _COUNT / rig.mm_per_px), rig
    )


def compute_statistics_by_size(
    rig: PatternRig, sizes_px: Sequence[float], coverage: float = 0.5
) -> dict[float, PatternStatistics]:
    """Return the image statistics of random dots with diameters ``sizes_px``, for a Boolean model."""
    found: dict[float, PatternStatistics] = {}
    for size in sizes_px:
        side, count = max(_THEORY_PX / 2, _THEORY_LENGTHS * size), _COUNT // 2
        dots = list_pattern_types()["speckle"].model_validate(
            {"kind": "speckle", "dot_mm": size, "coverage": coverage, "spacing": 0.0}
        )
        power = dots.power(count, side / count)
        assert power is not None
        found[size] = compute_pattern_statistics(PatternSpectrum(power, side / count), rig)
    return found


def assessments_to_dataframe(worths: Sequence[PatternAssessment]) -> pd.DataFrame:
    """Return the assessments of several patterns as a table."""
    import pandas as pd

    rows = [
        {"pattern": worth.label, "quantity": name, "value": value, "unit": UNITS[name]}
        for worth in worths
        for name, value in worth.statistics().items()
    ]
    return pd.DataFrame(rows).astype({"value": float})


def _range(pattern: Pattern, rig: PatternRig) -> float:
    """Return the difference between paper and ink, relative to full scale."""
    ink, paper = pattern.model.radiances
    return (paper - ink) * rig.light * compute_grey_level(rig, (paper + ink) / 2 * rig.light).gain


def _render_pattern(pattern: Pattern, rig: PatternRig) -> _ImagedPattern:
    """Return the grey values of the centre of a pattern."""
    sides_px = [min(side / rig.mm_per_px, _PATCH_PX) for side in pattern.size_mm]
    if min(sides_px) < _LEAST_PX:
        message = f"is less than {_LEAST_PX} px of the rig's image along a side: use a larger pattern"
        raise ArgumentError([Problem("size_mm", message, pattern.size_mm)], source="a pattern")
    columns, rows = (int(side) * _PARTS for side in sides_px)
    width, height = (count / _PARTS * rig.mm_per_px for count in (columns, rows))
    box = ((pattern.size_mm[0] - width) / 2, (pattern.size_mm[1] - height) / 2, width, height)
    shown = _illuminate(pattern.radiance(box, (rows, columns)).astype(np.float64), rig, 1 / _PARTS, texel_px=1 / _PARTS)
    brightest = float(shown.grey.max())
    if brightest > 1:
        message = f"saturates the sensor: paper would be at {100 * brightest:.0f} % of full scale; reduce the light, or"
        raise ArgumentError([Problem("light", f"{message} the exposure time", rig.light)], source="a pattern")
    return shown


def _illuminate(
    reflectance: Array, rig: PatternRig, pitch_px: float, texel_px: float = 0.0, noise_std: float = 0.0
) -> _ImagedPattern:
    """Return the grey values of a surface with given reflectance."""
    level = compute_grey_level(rig, float(reflectance.mean()) * rig.light)
    if level.gain <= 0:
        message = "saturates the sensor: the grey value does not depend on the light; reduce it"
        raise ArgumentError([Problem("light", message, rig.light)], source="a pattern")
    grey = level.grey + level.gain * rig.light * (reflectance - reflectance.mean())
    return _ImagedPattern(grey, level, pitch_px, rig, texel_px, noise_std * level.gain * rig.light)


def _assess(
    label: str,
    shown: _ImagedPattern,
    rig: PatternRig,
    theory: PatternStatistics | None,
    window_sigma_px: float,
    motion: str,
) -> PatternAssessment:
    spectrum = compute_spectrum(shown.grey, shown.pitch_px, shown.noise_std)
    seen = compute_pattern_statistics(spectrum, shown.optics, shown.texel_px)
    noise = shown.level.noise_std
    both = math.hypot(seen.gradient_x, seen.gradient_y)
    return PatternAssessment(
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
        patch=sample_patch(shown.grey, shown.pitch_px, shown.optics, _SHOWN_PX),
        **_precision(rig, seen, noise, window_sigma_px, motion),
    )


def _precision(
    rig: PatternRig, seen: PatternStatistics, noise: float, window_sigma_px: float, motion: str
) -> dict[str, float | None]:
    """Return the lowest standard deviations; None where the rig or a noise-free sensor does not define them."""
    names = [one.name for one in fields(ClosedFormBound)]
    if noise == 0 or rig.positions < 2 or min(seen.gradient_x, seen.gradient_y) <= 0:
        return dict.fromkeys(names)
    # Disparity is measured along x; quantities measured along both axes have the mean gradient.
    along, mean = (
        asdict(
            closed_form_bound(
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
        problems.append(Problem("picture_noise_std", "must be a fraction of full scale", picture_noise_std))
    if problems:
        raise ArgumentError(problems, source="a pattern")


SIZES_PX = (1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0)
"""Dot diameters in the size table."""

_ALIASED = 0.05
_BLEACHED, _DARK = 0.9, 0.1
_OWN_PX = 4.0


def describe_assessments(worths: Sequence[PatternAssessment]) -> list[str]:
    """Return sentences on the precision with each pattern, and comparisons with the first."""
    found = []
    for number, worth in enumerate(worths):
        text = f"{worth.label}: RMS gradient {100 * worth.gradient:.3g} % of full scale per px"
        text += (
            f", noise {format_two_digits(100 * worth.noise_std)} %, speckle size {format_two_digits(worth.size_px)} px"
        )
        if worth.disparity_px is not None:
            text += f"; lowest standard deviation of disparity {format_two_digits(worth.disparity_px)} px per step"
        if worth.depth_mm is not None:
            text += f", of depth {format_two_digits(worth.depth_mm)} mm"
        if worth.flow_px is not None:
            text += f", of flow {format_two_digits(worth.flow_px)} px per frame"
        found.append(f"{text} (window σ {worth.window_sigma_px:g} px)")
        found += _warnings(worth)
        if number and worths[0].gradient > 0 and worth.gradient > 0:
            ratio = _noise_over_gradient(worth) / _noise_over_gradient(worths[0])
            found.append(
                f"{worth.label}: {format_two_digits(ratio)} times the noise "
                f"of depth and motion (reference: {worths[0].label})"
            )
    return found


def _noise_over_gradient(worth: PatternAssessment) -> float:
    # For a noise-free sensor, compare the gradients.
    return (worth.noise_std or 1.0) / worth.gradient


def _warnings(worth: PatternAssessment) -> list[str]:
    found = []
    if worth.aliased_share > _ALIASED:
        share = f"{100 * worth.aliased_share:.0f} %"
        found.append(f"{worth.label}: {share} of the variance is beyond the Nyquist frequency: use a coarser pattern")
    if worth.mean > _BLEACHED:
        found.append(f"{worth.label}: {100 * worth.mean:.0f} % of full scale on average: reduce the exposure time")
    if worth.mean < _DARK:
        found.append(f"{worth.label}: {100 * worth.mean:.0f} % of full scale on average: increase the light")
    return found


def describe_pattern(pattern: Pattern) -> list[str]:
    """Return a description of a pattern, and its finest features at the smallest and largest depth."""
    rig, width = pattern.rig, pattern.size_mm
    found = [f"{pattern.model.kind} of {width[0]:g} x {width[1]:g} mm: {pattern.description}"]
    if rig.depth_range_mm is not None and rig.depth_range_mm[0] < rig.depth_range_mm[1]:
        near, far = (pattern.model.finest_mm * rig.focal_length_px / depth for depth in rig.depth_range_mm)
        depths = " and ".join(f"{depth:.0f} mm" for depth in rig.depth_range_mm)
        found.append(f"finest feature {near:.2f} and {far:.2f} px at the smallest and largest scene depth, {depths}")
    seen = rig.field_mm
    if seen is not None and (seen[0] > width[0] or seen[1] > width[1]):
        found.append(f"smaller than the field of view, {seen[0]:.0f} x {seen[1]:.0f} mm")
    return found


def compute_size_table(rig: PatternRig, coverage: float = 0.5) -> list[tuple[float, float, float, float]]:
    """Return dot diameters in px and mm, noise relative to dots of 4 px, and aliased fraction, for a Boolean model."""
    seen = compute_statistics_by_size(rig, SIZES_PX, coverage)
    own = seen[_OWN_PX].gradient_x
    return [(size, size * rig.mm_per_px, own / each.gradient_x, each.aliased_share) for size, each in seen.items()]


_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")  # colour-blind-safe colours (after Okabe and Ito)
_RINGS = 40


def plot_assessments(file: Path, worths: Sequence[PatternAssessment]) -> None:
    """Plot the imaged patterns, and their spectra after blur by lens and pixels."""
    import matplotlib.style
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.style.context(["default", {"font.size": 9}]):
        figure = Figure(figsize=(3.2 * len(worths) + 5.0, 3.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(worths) + 1, width_ratios=[*[3.2] * len(worths), 5.0])
        for ax, worth in zip(axes[:-1], worths, strict=True):
            assert worth.patch is not None
            ax.imshow(worth.patch, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            ax.set(title=worth.label, xlabel="x, px", ylabel="y, px")
        edges = np.linspace(0, 1.5 * NYQUIST, _RINGS + 1)
        middle = (edges[1:] + edges[:-1]) / 2
        for worth, colour in zip(worths, _COLOURS * len(worths), strict=False):
            assert worth.spectrum is not None
            density = compute_ring_means(worth.spectrum, worth.optics, edges)
            # Contribution of a ring to the squared gradient: its circumference, times (2 π f)² / 2 for one axis.
            adds = 4 * np.pi**3 * middle**3 * np.maximum(density, 0.0)
            axes[-1].plot(middle, adds, color=colour, label=worth.label)
        axes[-1].axvline(NYQUIST, color="0.5", linestyle=":", label="2 px")
        axes[-1].set(xlabel="spatial frequency, periods per px", ylabel="squared gradient per frequency")
        axes[-1].set(xlim=(0, edges[-1]), ylim=(0, None), title="squared gradient after lens and pixels")
        axes[-1].legend(frameon=False)
        figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})
