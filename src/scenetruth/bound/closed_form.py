"""Closed-form Cramér-Rao bound for a flat, fronto-parallel surface with a uniform texture."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scenetruth.bound.fisher_information import window_weights
from scenetruth.bound.unknowns import Motion
from scenetruth.errors import Problem, RecordingError

__all__ = ["ClosedFormBound", "closed_form_bound", "texture_gradient"]


@dataclass(frozen=True)
class ClosedFormBound:
    """Lowest standard deviations at the principal point, for a fronto-parallel surface with negligible motion.

    Parameters
    ----------
    disparity_px
        Standard deviation of the disparity, px per step.
    depth_mm
        Standard deviation of the depth, mm.
    slope
        Standard deviation of dZ/dX and of dZ/dY.
    flow_px
        Standard deviation of each component of optical flow, px per frame.
    velocity_lateral_mm
        Standard deviation of U_X and U_Y, mm per frame.
    velocity_depth_mm
        Standard deviation of U_Z, mm per frame.
    growth_rate
        Standard deviation of the growth rate, per frame; None for a motion without growth. For affine motion the
        variance of products of errors is included, as in `cramer_rao_bound`.

    See Also
    --------
    scenetruth.bound.closed_form_bound : Computes the values.
    scenetruth.bound.cramer_rao_bound : The bound at every pixel of a scene.

    Examples
    --------
    If the surface may grow, the bound of U_Z is higher, and there is a bound of the growth rate:

    >>> from scenetruth.bound import closed_form_bound
    >>> rig = {"focal_length_px": 1000, "baseline_mm": 5, "positions": 5, "frames": 5, "depth_mm": 500}
    >>> rig |= {"gradient": 2.2, "noise_std": 1.0}
    >>> rigid, growing = (closed_form_bound(**rig, motion=motion) for motion in ("rigid", "growing"))
    >>> round(rigid.velocity_depth_mm, 3), round(growing.velocity_depth_mm, 3)
    (0.097, 0.115)
    >>> rigid.growth_rate, round(growing.growth_rate, 5)
    (None, 0.00081)
    """

    disparity_px: float
    depth_mm: float
    slope: float
    flow_px: float
    velocity_lateral_mm: float
    velocity_depth_mm: float
    growth_rate: float | None


def texture_gradient(
    contrast: float, wavelength_px: float | tuple[float, float], spectrum_exponent: float = 0.0
) -> float:
    """Return the RMS derivative of a texture along one axis, in grey values per px.

    Parameters
    ----------
    contrast
        Standard deviation of the texture, in grey values.
    wavelength_px
        Wavelength in the image, or the shortest and the longest wavelength of isotropic noise.
    spectrum_exponent
        Exponent e of the power density, proportional to (spatial frequency) ** e, as for noise textures: 0 is white
        noise, and with -2 all octaves have equal power.

    Returns
    -------
    float
        2π contrast / (√2 λ); for a band, with the mean of 1/λ². Blur by lens and pixels is not included.

    Raises
    ------
    RecordingError
        If a number is not positive.

    See Also
    --------
    scenetruth.bound.closed_form_bound : Uses it as ``gradient``.

    Examples
    --------
    >>> round(texture_gradient(10.0, 20.0), 3), round(texture_gradient(10.0, (10.0, 40.0)), 3)
    (2.221, 3.238)
    """
    short, long = wavelength_px if isinstance(wavelength_px, tuple) else (wavelength_px, wavelength_px)
    _refuse({"contrast": contrast, "wavelength_px.0": short, "wavelength_px.1": long})
    if short == long:
        square = short**-2
    else:
        # A ring of frequencies f has an area in proportion to f.
        square = _integral(spectrum_exponent + 3, short, long) / _integral(spectrum_exponent + 1, short, long)
    return 2 * math.pi * contrast * math.sqrt(square / 2)


def closed_form_bound(
    *,
    focal_length_px: float,
    baseline_mm: float,
    positions: int,
    frames: int,
    depth_mm: float,
    gradient: float,
    noise_std: float,
    window_sigma_px: float = 6.0,
    motion: Motion = "rigid",
) -> ClosedFormBound:
    """Compute the closed-form Cramér-Rao bound of depth and motion.

    Assumptions: the surface is flat, fronto-parallel and visible in all images; its motion is negligible. Its disparity
    is larger than the window, so that rotations are not confused with motion. The texture has the same gradient along x
    and y everywhere. Slopes and a rotation are unknown, as in `cramer_rao_bound`; they do not affect the other results.

    Parameters
    ----------
    focal_length_px, baseline_mm
        Focal length of the camera; distance between neighbouring stage positions.
    positions, frames
        Number of cameras and of frames, evenly spaced around the reference.
    depth_mm
        Distance of the surface.
    gradient
        RMS derivative of the texture along one axis, in grey values per px; see `texture_gradient`.
    noise_std
        Standard deviation of the image noise, in grey values.
    window_sigma_px
        Standard deviation of the Gaussian window, which is truncated at two standard deviations.
    motion
        Motion model, as in `cramer_rao_bound`. With unknown growth, U_Z follows from the change of disparity only.

    Returns
    -------
    ClosedFormBound
        Infinite for quantities that need more than one position or frame.

    Raises
    ------
    RecordingError
        If a number is not positive or the motion model is unknown; lists all errors.

    See Also
    --------
    scenetruth.bound.texture_gradient : Gradient of a texture, from its contrast and wavelength.
    scenetruth.bound.cramer_rao_bound : The bound at every pixel of a scene.

    Notes
    -----
    With sums over the window m = Σ w and m' = Σ w ξ² of the weights, and v, v' of the squared weights, N = m² / v is
    the effective number of pixels. With E = N G², the disparity d, Σs² = S(S² - 1)/12 and Σt² accordingly,

        σ_d = σ / √(T Σs² E)      σ_u = σ / √(S Σt² E)      σ_Z = Z σ_d / d      σ_UX = Z σ_u / f

    U_Z follows from the change of disparity, D = d² Σs², and, without growth, also from the expansion of the window:

        σ_UZ = Z σ / √(Σt² E D)    or    Z σ √(2 S v' + D v) / ((2 S m' + D m) G √Σt²)

    The growth rate is twice the expansion of the window minus the contribution of U_Z. If the rotation of the surface
    is unconstrained (affine motion), the product of the errors of a slope and of its rate of change adds to the error
    of growth along each axis: √2 σ_slope σ_turn, with σ_turn = (f / d) σ √v' / (m' G √(Σs² Σt²)). At a distance x from
    the principal point, U_X = (Z u + x U_Z) / f also contains x / f of the error of U_Z.

    Examples
    --------
    A leaf at a distance of 500 mm, 8-bit images with noise of one grey value, 3 and 9 positions:

    >>> gradient = texture_gradient(contrast=10, wavelength_px=20)
    >>> rig = {"focal_length_px": 1000, "baseline_mm": 5, "frames": 5, "depth_mm": 500}
    >>> three, nine = (closed_form_bound(**rig, positions=n, gradient=gradient, noise_std=1) for n in (3, 9))
    >>> round(three.depth_mm, 3), round(nine.depth_mm, 3)
    (0.36, 0.066)

    A single camera gives no depth:

    >>> closed_form_bound(**rig, positions=1, gradient=gradient, noise_std=1).depth_mm
    inf
    """
    numbers = {
        "focal_length_px": focal_length_px,
        "baseline_mm": abs(baseline_mm),
        "positions": positions,
        "frames": frames,
        "depth_mm": depth_mm,
        "gradient": gradient,
        "noise_std": noise_std,
        "window_sigma_px": window_sigma_px,
    }
    _refuse(numbers, motion)
    one, _, square = (float(each) for each in window_weights("gaussian", window_sigma_px).sum(axis=1))
    weights = window_weights("gaussian", window_sigma_px)
    one2, square2 = (float((weights[0] * weights[k]).sum()) for k in (0, 2))
    # The kernel is separable: sums over the window are products of sums along x and along y.
    m, m_x, v, v_x = one**2, one * square, one2**2, one2 * square2
    disparity = focal_length_px * abs(baseline_mm) / depth_mm
    over_s, over_t = _squares(positions), _squares(frames)
    unit = noise_std / gradient
    d = unit * _root(v, m, frames * over_s)
    u = unit * _root(v, m, positions * over_t)
    moved = disparity**2 * over_s
    # Standard deviations of the rate of approach, u_z = -U_Z / Z, and of the rate of expansion of the window.
    apart = unit * _root(v, m, over_t * moved)
    spread = unit * _root(2 * v_x, 2 * m_x, positions * over_t)
    both = 2 * positions * m_x + moved * m
    rigid = unit * math.sqrt(2 * positions * v_x + moved * v) / both / math.sqrt(over_t) if over_t else math.inf
    grows = motion in ("growing", "affine")
    steep = focal_length_px / disparity * unit * _root(v_x, m_x, frames * over_s)
    turn = focal_length_px / disparity * unit * _root(v_x, m_x, over_t * over_s)
    product = steep * turn if motion == "affine" else 0.0
    return ClosedFormBound(
        disparity_px=d,
        depth_mm=depth_mm * d / disparity,
        slope=steep,
        flow_px=u,
        velocity_lateral_mm=depth_mm * u / focal_length_px,
        velocity_depth_mm=depth_mm * (apart if grows else rigid),
        growth_rate=math.sqrt(4 * (spread**2 + apart**2) + 2 * product**2) if grows else None,
    )


def _integral(power: float, short: float, long: float) -> float:
    """Return the integral of frequency ** power over a band of wavelengths."""
    raised, octaves = power + 1, math.log(long / short)
    if raised == 0:
        return octaves
    # The plain difference of the antiderivative would lose precision where the power is nearly -1.
    return float(short**-raised * -math.expm1(-raised * octaves) / raised)


def _squares(count: int) -> float:
    """Return the sum of squares of ``count`` numbers of unit spacing, centred at 0."""
    return count * (count**2 - 1) / 12


def _root(scatter: float, normal: float, factor: float) -> float:
    """Return √(S / H²) with H = ``factor`` ``normal`` and S = ``factor`` ``scatter``."""
    return math.sqrt(scatter / factor) / normal if factor else math.inf


def _refuse(numbers: dict[str, float], motion: str = "rigid") -> None:
    problems = [
        Problem(name, "must be a positive number", value)
        for name, value in numbers.items()
        if not (0 < value < math.inf)
    ]
    if motion not in ("translation", "rigid", "growing", "affine"):
        problems.append(Problem("motion", "must be one of translation, rigid, growing, affine", motion))
    if problems:
        raise RecordingError(problems, source="a rig")
