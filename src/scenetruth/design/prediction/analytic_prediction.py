"""Analytic prediction in milliseconds, from surface samples and texture spectra without rendering."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.fisher_information import GROWTH_BIAS
from scenetruth.bound.unknowns import MotionChoice, compute_eigenvalue_bias
from scenetruth.design.prediction.method_models import MethodSetup, all_method_models, prepare_method
from scenetruth.design.prediction.prediction_result import Prediction, PredictionInputs
from scenetruth.design.prediction.region_statistics import (
    compute_quantities,
    compute_values,
    select_regions,
    weighted_median,
    weighted_quantile,
)
from scenetruth.design.prediction.surface_samples import SurfaceSamples, sample_surface
from scenetruth.design.prediction.texture_information import ImagedTexture, compute_flow, compute_imaged_texture
from scenetruth.design.prediction.texture_spectra import analytic_spectra
from scenetruth.errors import Problem, SceneError
from scenetruth.number_format import format_two_digits
from scenetruth.resources import ObjectWorkload
from scenetruth.scene import Scene

__all__ = ["AS_MATT", "NO_SHADOWS", "NO_STAGE_ERRORS", "PointErrors", "predict_analytic", "predict_with_highlights"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST_NAMES = 3
NO_SHADOWS, AS_MATT = "shadows are not included", "surfaces with a material are predicted as matt"
"""Notes on light that only images include."""
NO_STAGE_ERRORS = "stage errors are not included"
_S_PER_H = 3600.0
_LARGE_BIAS = 0.3  # relative to the standard deviation: a smaller bias hardly changes the RMSE
# Quintic splines attenuate a wave of 3 px by 1.5 % and add an equally strong alias. Errors on a cube with 45 % of its
# squared gradients in shorter waves are 2.2 times the prediction; with 21 % they agree within the scatter of seeds.
_FINE_PX, _MUCH_FINE = 3.0, 0.35
# Gradient energies, relative to that of the strongest direction, from which `refined` determines motion and disparity.
# It rejects 60 to 80 % of the windows if their mean ratio is 0.008 (directions within 10 degrees), 5 % if it is 0.02.
_LEAST_RATIO, _LEAST_ALONG = 0.015, 1.5e-3
_SOME = 0.2  # smallest share of an object that is reported
_WINDOW_SIGMAS, _MUCH_BORDER = 2.0, 0.2
"""Half width of a window in standard deviations; share of points near borders of images from which a note says so."""
_MOST_BLUR, _RESTS_PX = 0.95, 1e-6  # evaluated over moving points only: a static background is not blurred


@dataclass(frozen=True, eq=False)
class PointErrors:
    """Variances by highlights of the quantities at surface points.

    ``x``, ``y``: Image positions from the principal point, px. ``variances``: By the names of `compute_functionals`.
    """

    x: Array
    y: Array
    body: NDArray[np.int64]
    names: tuple[str, ...]
    variances: Mapping[str, Array]


def predict_analytic(
    scene: Scene,
    method: str,
    window_sigma_px: float | None,
    motion: MotionChoice | None,
    parts: Sequence[ObjectWorkload],
    folder: Path = Path(),
    *,
    painting: bool = True,
) -> Prediction:
    """Predict the precision of a scene from surface samples and spectra; see `predict_with_highlights`."""
    return predict_with_highlights(scene, method, window_sigma_px, motion, parts, folder, painting=painting)[0]


def predict_with_highlights(
    scene: Scene,
    method: str,
    window_sigma_px: float | None,
    motion: MotionChoice | None,
    parts: Sequence[ObjectWorkload],
    folder: Path = Path(),
    *,
    painting: bool = True,
) -> tuple[Prediction, PointErrors | None]:
    """Predict the precision of a scene from surface samples and spectra, and the errors by highlights, if any.

    Without ``painting``, approximate spectra are used, objects without a spectrum are omitted, and no code is compiled.
    """
    scene.require_grey("a prediction")
    setup = prepare_method(scene, method, window_sigma_px, motion)
    look = sample_surface(setup.scene, parts, folder)
    if painting and len(look) and _reflects(scene):
        look = _with_reflection(setup.scene, look, parts, folder)
    unknown: list[str] = []
    if not painting:
        kinds = {part.item.name: part.item.texture.kind for part in parts}
        unknown = [name for name in look.names if kinds[name] not in analytic_spectra()]
        look = look.of([number for number, name in enumerate(look.names) if name not in unknown])
    if not len(look) and unknown:
        message = f"textures of {', '.join(unknown)} have no analytic spectrum; "
        raise SceneError([Problem("objects", message + "run `scenetruth design predict`, which paints them")])
    if not len(look):
        message = "none is visible to the reference camera at the reference frame"
        raise SceneError([Problem("objects", message)])
    seen = compute_imaged_texture(setup.scene, look, parts, folder, painting=painting)
    problems = noise_problems(scene, seen.noise)
    if problems:
        raise SceneError(problems)
    slopes = _slopes(look)
    with np.errstate(all="ignore"):
        deviations = all_method_models()[method].from_spectrum(setup, look, seen)
        std = compute_quantities(deviations, slopes)
        cost: dict[str, float] = {}
        if (seen.pattern > 0).any():
            without = replace(seen, pattern=np.zeros_like(seen.pattern))
            less = compute_quantities(all_method_models()[method].from_spectrum(setup, look, without), slopes)
            cost = {name: _median_ratio(std[name], less[name]) for name in std}
            # The same factor at all points: factors of single points scatter with the waves of their texture.
            std = {name: cost[name] * values for name, values in less.items()}
    regions = select_regions(look.names, look.body, look.far_from_edges(scene.score.interior_margin_px))
    interval = scene.frames.frame_interval_s
    figures = compute_values(std, compute_signals(setup, look), regions, look.share, interval)
    entries = _point_inputs(look, seen)
    causes = {
        region: _summarise_inputs(setup, entries, seen.blur_px, mask, look.share) for region, mask in regions.items()
    }
    notes = (
        *_notes(scene, look, method, unknown, painting=painting),
        *_too_fine(look, seen),
        *(_describe_invalid_windows(setup, scene, look, seen) if method == "refined" else ()),
        *(_describe_borders(setup, scene, look) if method == "refined" else ()),
        *_describe_eigenvalue_bias(deviations, look, interval),
    )
    shares = _compute_bias_shares(deviations, regions, look.share)
    made = Prediction("analytic", method, tuple(regions), interval, figures, causes, None, notes, cost, shares)
    return made, _highlight_errors(method, setup, look, seen, deviations)


def _highlight_errors(
    method: str, setup: MethodSetup, look: SurfaceSamples, seen: ImagedTexture, deviations: Mapping[str, Array]
) -> PointErrors | None:
    """Return what highlights add to the variances at points; None without glossy surfaces."""
    if look.reflection is None or not look.reflection.glossy[look.body].any():
        return None
    with np.errstate(all="ignore"):
        plain = all_method_models()[method].from_spectrum(setup, replace(look, reflection=None), seen)
        added = {
            name: np.maximum(values**2 - plain[name] ** 2, 0.0) for name, values in deviations.items() if name in plain
        }
    return PointErrors(look.points.x, look.points.y, look.body, look.names, added)


def _reflects(scene: Scene) -> bool:
    """Return whether the light on surfaces depends on materials or the size of lamps."""
    lighting = scene.lighting
    return lighting.lit and (lighting.has_areas or any(not item.material.matt for _, item in scene.parts))


def _with_reflection(
    scene: Scene, look: SurfaceSamples, parts: Sequence[ObjectWorkload], folder: Path
) -> SurfaceSamples:
    """Return points with the light of materials and lamps with a size, by the code that renders images."""
    from scenetruth.design.prediction.surface_light import SurfaceLight

    reflection = SurfaceLight(scene, parts, folder)
    factor, gloss = reflection.at(look.points.x, look.points.y)
    known = np.isfinite(factor)
    light, gloss = np.where(known, factor, look.light), np.where(known, gloss, 0.0)
    return replace(look, light=light, gloss=gloss, reflection=reflection)


def _compute_bias_shares(std: Mapping[str, Array], regions: Mapping[str, Mask], share: Array) -> dict[str, float]:
    """Return the share of the bias of isotropic growth in the variance of the growth rate, by region."""
    found: dict[str, float] = {}
    if GROWTH_BIAS not in std:
        return found
    for region, mask in regions.items():
        known = mask & np.isfinite(std["growth_rate"]) & np.isfinite(std[GROWTH_BIAS])
        whole = float(np.sum(share[known] * std["growth_rate"][known] ** 2))
        if whole > 0:
            found[region] = float(np.sum(share[known] * std[GROWTH_BIAS][known] ** 2)) / whole
    return found


def _median_ratio(one: Array, other: Array) -> float:
    known = np.isfinite(one) & np.isfinite(other) & (other > 0)
    return float(np.median(one[known] / other[known])) if known.any() else 1.0


def noise_problems(scene: Scene, noise: Array) -> list[Problem]:
    """Return the problems of a sensor without noise."""
    if (noise > 0).all():
        return []
    message = "has no noise, so precision is unlimited: set noise_std or bit_depth"
    return [Problem("sensor", message, scene.sensor if isinstance(scene.sensor, str) else scene.sensor.kind)]


def compute_signals(setup: MethodSetup, look: SurfaceSamples) -> dict[str, Array]:
    """Return the true motion and growth of points, by quantity."""
    if not setup.sees_motion:
        return {}
    flow = compute_flow(look)
    velocity = look.points.q * setup.scene.stage.baseline_mm
    found = {f"flow_{axis}": flow[:, k] for k, axis in enumerate("xy")}
    found |= {f"velocity_{axis}": velocity[k] for k, axis in enumerate("xyz")}
    found |= dict(zip(("growth_principal_1", "growth_principal_2"), look.principal_growth_rates, strict=True))
    return {**found, "velocity_epe": np.linalg.norm(velocity, axis=0), "growth_rate": look.growth}


def _slopes(look: SurfaceSamples) -> Array:
    # A plane n · P = c has dZ/dX = -n_X / n_Z.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(-look.normals[:, :2].T / look.normals[:, 2])


def _point_inputs(look: SurfaceSamples, seen: ImagedTexture) -> dict[str, Array]:
    along, down = (np.sqrt((seen.variance * seen.response[..., k] ** 2).sum(axis=1)) for k in range(2))
    contrast, whole = (np.sqrt(each.sum(axis=1)) for each in (seen.variance, seen.surface_variance))
    with np.errstate(invalid="ignore", divide="ignore"):
        wavelength = np.where(contrast > 0, 2 * np.pi * contrast / np.hypot(along, down), np.inf)
        left = np.where(whole > 0, contrast / whole, 0.0)
    return {
        "noise_std": seen.noise,
        "pattern_std": seen.pattern,
        "grey_level": seen.level,
        "white_level": seen.white,
        "contrast": contrast,
        "gradient_x": along,
        "gradient_y": down,
        "transfer": left,
        "wavelength_px": wavelength,
        "disparity_px": np.abs(look.points.d),
        "depth_mm": look.depth_mm,
        "flow_px": np.hypot(*compute_flow(look).T),
    }


def _summarise_inputs(
    setup: MethodSetup, inputs: Mapping[str, Array], blur_px: Array, mask: Mask, share: Array
) -> PredictionInputs:
    moving = mask & (blur_px > _RESTS_PX)
    return PredictionInputs(
        **{name: weighted_median(values[mask], share[mask]) for name, values in inputs.items()},
        blur_px=weighted_quantile(blur_px[moving], share[moving], _MOST_BLUR) if moving.any() else 0.0,
        window_sigma_px=setup.window_sigma_px,
        motion="auto" if setup.automatic else setup.motion,
        positions=len(np.unique(np.stack([setup.views.s, setup.views.s_y]), axis=1).T),
        frames=len(np.unique(setup.views.t)),
    )


def _notes(
    scene: Scene, look: SurfaceSamples, method: str, unknown: Sequence[str], *, painting: bool
) -> tuple[str, ...]:
    """Return the effects that are not included in a prediction."""
    seen = {look.names[number] for number in np.unique(look.body)}
    shown = [item for _, item in scene.parts if item.name in seen]
    veined = [item.name for item in shown if not _is_exact(item.texture.kind)]
    coated = [item.name for item in shown if not item.material.matt and (not painting or item.material.from_file)]
    predicted = painting and method == "refined"
    glossy = [item.name for item in shown if item.material.glossy and (item.material.from_file or not predicted)]
    lighting = scene.lighting
    found: Mapping[str, bool] = {
        f"omitted, because their files are slow to read: {', '.join(look.left_out)}": bool(look.left_out),
        f"omitted, because their textures must be painted first: {', '.join(unknown)}": bool(unknown),
        f"leaf veins are not included, so the precision is better than predicted: {_listed(veined)}": bool(veined)
        and not painting,
        "lens distortion is not included": scene.camera.distortion is not None,
        NO_STAGE_ERRORS: bool(scene.stage.stated_tolerances()) or scene.stage.errors is not None,
        NO_SHADOWS: lighting.lit and lighting.shadows and bool(lighting.lights),
        f"{AS_MATT}: {_listed(coated)}": lighting.lit and bool(coated),
        "lamps with a size are predicted as small lamps at their centres": lighting.has_areas and not painting,
        f"errors by highlights are not included: {_listed(glossy)}": lighting.lit and bool(glossy),
    }
    return tuple(words for words, holds in found.items() if holds)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_MOST_NAMES]) + (" and others" if len(names) > _MOST_NAMES else "")


def _too_fine(look: SurfaceSamples, seen: ImagedTexture) -> Iterator[str]:
    """Yield a note if interpolation between pixels attenuates the texture."""
    gradient = seen.variance * (seen.response**2).sum(axis=-1)
    fine = np.hypot(seen.frequency[..., 0], seen.frequency[..., 1]) > 1 / _FINE_PX
    weight = look.share[:, None] * gradient
    total = float(weight.sum())
    share = float(weight[fine].sum()) / total if total > 0 else 0.0
    if share > _MUCH_FINE:
        yield (
            f"{100 * share:.0f} % of the squared gradients have wavelengths shorter than {_FINE_PX:g} px, which "
            "interpolation between pixels attenuates: the resulting bias is not included"
        )


def _describe_invalid_windows(
    setup: MethodSetup, scene: Scene, look: SurfaceSamples, seen: ImagedTexture
) -> Iterator[str]:
    """Yield notes on textures whose windows are invalid or ambiguous."""
    xx, xy, yy = (
        (seen.variance * seen.response[..., k] * seen.response[..., m]).sum(axis=1) for k, m in ((0, 0), (0, 1), (1, 1))
    )
    middle, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    s, s_y = (each - each.mean() for each in (setup.views.s, setup.views.s_y))
    spread = float(np.sum(s**2 + s_y**2))
    along = (np.sum(s**2) * xx + 2 * np.sum(s * s_y) * xy + np.sum(s_y**2) * yy) / spread if spread > 0 else middle
    # Motion requires two directions of the image, disparity that of the baselines.
    lost = np.zeros(len(look), dtype=np.bool_)
    if setup.sees_motion:
        lost |= middle - half < _LEAST_RATIO * (middle + half)
    if setup.sees_depth:
        lost |= along < _LEAST_ALONG * (middle + half)
    lost &= middle > 0
    angle = np.degrees(0.5 * np.arctan2(2 * xy, xx - yy))
    for number in np.unique(look.body[lost]).tolist():
        own = lost & (look.body == number)
        if float(look.share[own].sum()) > _SOME * float(look.share[look.body == number].sum()):
            direction = weighted_median(angle[own], look.share[own])
            yield (
                f"the texture of {look.names[number]} varies almost only along {direction:.0f} degrees to the image "
                "rows: the method marks most of its windows as invalid, and errors exceed the prediction"
            )
    repetitive = {item.name for _, item in scene.parts if item.texture.repetitive}
    repeated = [look.names[number] for number in np.unique(look.body).tolist() if look.names[number] in repetitive]
    if repeated:
        yield (
            f"repetitive textures have several matches, which the method marks as ambiguous (invalid) unless "
            f"max_motion_px excludes them: {_listed(repeated)}"
        )


def _describe_borders(setup: MethodSetup, scene: Scene, look: SurfaceSamples) -> Iterator[str]:
    """Yield a note on objects with many points at borders of images, where windows are cut and images are missing."""
    reach = _WINDOW_SIGMAS * setup.window_sigma_px
    x0, y0 = scene.camera.principal_point
    whole = np.ones(len(look), dtype=np.bool_)
    for s, s_y, t in zip(setup.views.s, setup.views.s_y, setup.views.t, strict=True):
        place = look.points.place(float(s), float(s_y), float(t))
        for values, middle, size in ((place.x, x0, scene.camera.width), (place.y, y0, scene.camera.height)):
            whole &= (values + middle >= reach) & (values + middle <= size - 1 - reach)
    cut = []
    for number in np.unique(look.body).tolist():
        own = look.body == number
        share = float(look.share[own & ~whole].sum() / look.share[own].sum())
        cut += [f"{100 * share:.0f} % of {look.names[number]}"] if share > _MUCH_BORDER else []
    if cut:
        yield (
            f"within {reach:g} px of the border of an image, or outside it, errors are up to four times the "
            f"prediction, which is a median: {_listed(cut)}"
        )


def _describe_eigenvalue_bias(std: Mapping[str, Array], look: SurfaceSamples, frame_interval_s: float) -> Iterator[str]:
    """Yield a note if noise causes a considerable bias of the principal growth rates."""
    if "growth_apart" not in std:
        return
    largest, least = look.principal_growth_rates
    bias = compute_eigenvalue_bias(0.5 * (largest - least), std["growth_apart"], std["growth_shear"])
    known = np.isfinite(bias) & np.isfinite(std["principal_growth_rates.0"])
    if not known.any():
        return
    middle, noise = (
        weighted_median(each[known], look.share[known]) * 100.0 * _S_PER_H / frame_interval_s
        for each in (bias, std["principal_growth_rates.0"])
    )
    if middle > _LARGE_BIAS * noise:
        yield (
            f"principal growth rates differ by less than their noise, which biases them: on average the "
            f"largest is {format_two_digits(middle)} %/h too large, and the smallest too small by the same amount"
        )


def _is_exact(kind: str) -> bool:
    return kind not in analytic_spectra() or analytic_spectra()[kind].exact
