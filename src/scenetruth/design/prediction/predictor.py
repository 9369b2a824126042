"""Prediction of the precision of a scene, and recommendations of scene fields to change."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from scenetruth.bound.unknowns import MotionChoice
from scenetruth.design.prediction.analytic_prediction import predict_analytic, predict_with_highlights
from scenetruth.design.prediction.prediction_result import Model, PredictedValue, Prediction, write_prediction
from scenetruth.design.prediction.texture_spectra import analytic_spectra
from scenetruth.errors import ArgumentError, Problem
from scenetruth.estimators.method_specs import MethodLike, MethodSpec, read_method
from scenetruth.number_format import format_two_digits
from scenetruth.resources import Limits, ObjectWorkload, limited_objects, load_checked_scene
from scenetruth.scene import Overrides, Scene, SceneLike

__all__ = ["predict", "predict_quickly", "recommend"]


SUFFICIENT_RATIO = 2.0
"""Required ratio of a signal to its standard deviation."""

_DEPTH_SHARE = 0.01  # acceptable standard deviation of depth, relative to depth
_WAVES_PER_SIGMA = 8.0  # largest wavelength in standard deviations of the window: half a wave per width of the window
_LEAST_TRANSFER, _LEAST_DENSITY = 0.4, 0.5
# Motion during the exposure relative to the wavelength: beyond, less than two thirds of the contrast remain.
_MOST_BLUR, _BETTER_BLUR = 0.5, 0.3
_WIDEST_PX = 30.0
_FULL = 1 + 1e-6  # tolerance for rounding of grey values at full scale
_NEARLY = 0.9  # a longer interval moves surfaces to positions where the texture is imaged differently
_NOTHING = 1e-7  # growth below this value is rounding of coarse meshes

Predictor = Callable[[Scene], Prediction]


def make_recommendations(
    scene: Scene,
    prediction: Prediction,
    again: Predictor,
    *,
    enough: float = SUFFICIENT_RATIO,
    growth_alone: bool = False,
) -> list[str]:
    """Return recommendations for a prediction, one per line."""
    found = list(_check_growth(scene, prediction, again, enough))
    if not growth_alone:
        found += [*_check_motion(scene, prediction, again, enough), *_check_depth(scene, prediction)]
        found += _check_images(scene, prediction)
    return found


def _check_growth(scene: Scene, prediction: Prediction, again: Predictor, enough: float) -> Iterator[str]:
    region = _most_moving(prediction, "growth_rate")
    if region is None:
        return
    figure = prediction.precision("growth_rate", region)
    if _is_sufficient(figure, enough):
        return
    signal, std = (100.0 * each for each in (figure.signal or 0.0, figure.std))
    text = (
        f"growth{_region_suffix(region)} is {format_two_digits(signal)} % per "
        f"frame at a precision of {format_two_digits(std)} % per pixel"
    )
    yield f"{text}: {_longer(scene, region, 'growth_rate', figure, again) or _wider(scene, figure, 2.0)}"


def _check_motion(scene: Scene, prediction: Prediction, again: Predictor, enough: float) -> Iterator[str]:
    quantity = next((name for name in ("velocity_epe", "flow_x") if name in prediction.quantities), None)
    region = None if quantity is None else _most_moving(prediction, quantity)
    if quantity is None or region is None:
        return
    figure = prediction.precision(quantity, region)
    if _is_sufficient(figure, enough) or figure.signal is None:
        return
    text = (
        f"motion{_region_suffix(region)} is {format_two_digits(figure.signal)} "
        f"{figure.unit} at a precision of {format_two_digits(figure.std)}"
    )
    yield f"{text}: {_longer(scene, region, quantity, figure, again) or _wider(scene, figure, 1.0)}"


def _check_depth(scene: Scene, prediction: Prediction) -> Iterator[str]:
    if "depth" not in prediction.quantities:
        return
    std, depth = prediction.precision("depth", "all").std, prediction.causes.depth_mm
    if math.isfinite(std) and std > _DEPTH_SHARE * depth:
        # The precision of depth is proportional to the baseline.
        enough = _nice(abs(scene.stage.baseline_mm) * std / (_DEPTH_SHARE * depth))
        text = (
            f"depth has a precision of {format_two_digits(std)} mm at "
            f"{depth:.4g} mm, {format_two_digits(100 * std / depth)} %"
        )
        yield f"{text}: raise stage.baseline_mm to {enough:g}"
    share = prediction.precision("depth", "all").valid_fraction
    if share < _LEAST_DENSITY:
        text = f"depth is valid in {100 * share:.0f} % of the visible surface only"
        yield f"{text}: add texture to the surfaces, or reduce stage.baseline_mm, so that all images show them"


def _check_images(scene: Scene, prediction: Prediction) -> Iterator[str]:
    causes = prediction.causes
    sigma = causes.window_sigma_px
    if math.isfinite(causes.wavelength_px) and causes.wavelength_px > _WAVES_PER_SIGMA * sigma:
        text = f"the texture wavelength is about {causes.wavelength_px:.0f} px, and the standard deviation of "
        text += f"the window is {sigma:g} px: reduce the texture wavelength, or raise "
        yield text + f"estimate.window_sigma_px to {_nice(causes.wavelength_px / _WAVES_PER_SIGMA):g}"
    objects = {name: one for name, one in prediction.by_region.items() if name.startswith("object_")}
    region = max(objects, key=lambda name: objects[name].brightest_level)
    brightest = objects[region].brightest_level
    if brightest > _FULL:
        remedy = "reduce lighting" if scene.lighting.lit else "reduce the light collected by the sensor"
        where = _region_suffix(region)
        yield f"brightest grey values{where} are at {100 * brightest:.0f} % of full scale, saturated: {remedy}"
    time = scene.shutter.exposure_time_s
    # A static background behind a moving object is not blurred, and has another wavelength.
    region = max(objects, key=lambda name: objects[name].blur_px / objects[name].wavelength_px)
    moving = objects[region]
    if moving.blur_px > _MOST_BLUR * moving.wavelength_px and time > 0:
        # With less blur, shorter wavelengths remain visible.
        shorter = time * _BETTER_BLUR * moving.wavelength_px / moving.blur_px
        text = f"points{_region_suffix(region)} move {moving.blur_px:.1f} px during the exposure, "
        waves = f"the texture wavelength is about {moving.wavelength_px:.1f} px"
        yield f"{text}and {waves}: reduce shutter.exposure_time_s to {format_two_digits(shorter)}"
    elif 0 < causes.transfer < _LEAST_TRANSFER:
        text = f"lens and pixels reduce the texture contrast to {100 * causes.transfer:.0f} %"
        yield f"{text}: increase the texture wavelength, or change optics"


def _most_moving(prediction: Prediction, quantity: str) -> str | None:
    """Return the object with the largest signal; None without any."""
    if quantity not in prediction.quantities:
        return None
    signals = {
        region: prediction.precision(quantity, region).signal or 0.0
        for region in prediction.regions
        if region.startswith("object_")
    }
    best = max(signals, key=lambda region: signals[region], default=None)
    return best if best is not None and signals[best] > _NOTHING else None


def _is_sufficient(figure: PredictedValue, enough: float) -> bool:
    ratio = figure.signal_to_noise
    return ratio is None or ratio >= enough or not math.isfinite(figure.std)


def _region_suffix(region: str) -> str:
    return f" of '{region.removeprefix('object_')}'"


def _longer(scene: Scene, region: str, quantity: str, figure: PredictedValue, again: Predictor) -> str | None:
    """Return the recommended longer interval, if the signal grows with it."""
    interval = _nice(scene.frames.frame_interval_s * _missing(figure))
    frames = scene.frames.model_copy(update={"frame_interval_s": interval})
    changed = again(scene.model_copy(update={"frames": frames}))
    if region not in changed.regions:
        return None
    ratio = changed.precision(quantity, region).signal_to_noise or 0.0
    # Motion specified per frame does not change.
    if ratio < _NEARLY * SUFFICIENT_RATIO:
        return None
    return f"raise frames.frame_interval_s to {interval:g}"


def _wider(scene: Scene, figure: PredictedValue, power: float) -> str:
    """Return another recommendation; the standard deviation is proportional to window width ** -``power``."""
    factor = _missing(figure)
    sigma = getattr(scene.estimate.settings, "window_sigma_px", None)
    if sigma is not None and (wider := _nice(sigma * factor ** (1 / power))) <= _WIDEST_PX:
        return f"raise estimate.window_sigma_px to {wider:g}, or the motion in the scene"
    return f"a factor of {format_two_digits(factor)} in noise or motion is missing: the motion is specified per frame"


def _missing(figure: PredictedValue) -> float:
    """Return the factor by which the signal is too small."""
    return SUFFICIENT_RATIO / max(figure.signal_to_noise or 0.0, 1e-9)


def _nice(value: float) -> float:
    """Return the next larger number with two digits."""
    size = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / size - 1e-9) * size:.3g}")


def predict(
    scene: SceneLike,
    *,
    method: MethodLike | None = None,
    model: Model = "analytic",
    settings: Mapping[str, Any] | None = None,
    window_sigma_px: float | None = None,
    motion: MotionChoice | None = None,
    overrides: Overrides = (),
    limits: Limits | None = None,
    output: str | Path | None = None,
    overwrite: bool = False,
) -> Prediction:
    """Predict the standard deviations of depth, slopes, motion and growth of a scene, without simulating noise.

    Parameters
    ----------
    scene
        The scene, its values, its file, or the name of a bundled scene.
    method
        Estimation method: ``"refined"`` or ``"structure_tensor"``, with settings if given as
        `scenetruth.estimators.MethodSpec`. Default: the method of the scene. Settings of the scene apply if it
        specifies the same method.
    model
        ``"analytic"``: from geometry and texture spectrum, in milliseconds. ``"maps"``: from one rendered noise-free
        image and the exact ground truth, in seconds, with maps.
    settings
        Settings of the method to replace.
    window_sigma_px
        Standard deviation of the window in px; default: the setting of the method.
    motion
        Motion model: ``"translation"``, ``"rigid"``, ``"growing"``, ``"affine"`` or ``"auto"``; default: the setting of
        the method. ``"auto"`` is ``"affine"`` where the bias of isotropic growth exceeds the noise that the affine
        model adds; elsewhere ``"growing"``, and the standard deviation of growth includes this bias.
    overrides
        Changes to the scene, as in `scenetruth.load_scene`.
    limits
        Limits on the scene (`scenetruth.Limits`); default: the standard limits.
    output
        Directory of the table ``prediction.csv`` and, with ``maps``, of the figure ``prediction.png``; by default
        nothing is written.
    overwrite
        Whether an existing prediction in ``output`` may be replaced.

    Returns
    -------
    Prediction
        Standard deviations by region and quantity, and their inputs.

    Raises
    ------
    OutputExistsError
        If ``output`` exists and ``overwrite`` is false.
    ArgumentError
        If an argument is invalid; lists all errors.
    SceneError
        If the scene is invalid or exceeds a limit, no surface is visible, its sensor has no noise, or an argument is
        invalid; lists all errors.

    See Also
    --------
    scenetruth.bound.cramer_rao_bound : The bound of a recording with ground truth.

    Examples
    --------
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 600]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    >>> plain = {"camera": {"width": 160, "height": 120, "focal_length_px": 2000}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "frames": {"count": 5}, "sensor": {"noise_std": 0.01}}
    >>> prediction = predict(plain, method="refined")
    >>> depth = prediction.precision("depth", "all")
    >>> f"{depth.value:.2f} {depth.value_unit}"
    '0.05 mm'
    """
    if model not in ("analytic", "maps"):
        raise ArgumentError([Problem("model", "must be analytic or maps", model)])
    known = load_checked_scene(scene, overrides=overrides, limits=limits or Limits())
    parts = limited_objects(known, limits or Limits())
    if method is not None or settings:
        spec = read_method(known.estimate.method if method is None else method)
        spec = MethodSpec(spec.method, {**spec.settings, **(settings or {})})
        known = known.model_copy(update={"estimate": spec.choice(known.estimate)})
    name = known.estimate.method
    made, highlights = predict_with_highlights(known, name, window_sigma_px, motion, parts)
    if model == "maps":
        # Compiled code is loaded only for this model.
        from scenetruth.design.prediction.map_prediction import predict_maps

        made = predict_maps(known, name, window_sigma_px, motion, made, highlights)
    if output is not None:
        write_prediction(made, Path(output), overwrite=overwrite)
    return made


def predict_quickly(scene: Scene, parts: Sequence[ObjectWorkload], method: str) -> Prediction:
    """Predict the precision of a scene analytically, without loading compiled code or painting textures."""
    return predict_analytic(scene, method, None, None, parts, painting=False)


def recommend(
    scene: Scene,
    prediction: Prediction,
    parts: Sequence[ObjectWorkload] | None = None,
    *,
    painting: bool = True,
    growth_alone: bool = False,
) -> list[str]:
    """Return recommendations where the predicted precision is insufficient: which field to change, and to which value.

    Parameters
    ----------
    scene
        The scene.
    prediction
        Prediction for the scene.
    parts
        Workloads of its objects, if already computed.
    painting
        Whether textures without an analytic spectrum may be painted. If not, their predicted standard deviations are
        too large, and only signals that cannot be detected at all are reported.
    growth_alone
        Whether to check growth only.

    Returns
    -------
    list of str
        One line per recommendation; empty if the precision is sufficient.

    See Also
    --------
    predict : The prediction.

    Examples
    --------
    A sheet that grows by 2 % per hour, recorded every minute, and then at the recommended interval:

    >>> from scenetruth.design.prediction import recommend, predict
    >>> sheet = {"name": "sheet", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 600]}}
    >>> sheet |= {"texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    >>> sheet |= {"deformation": [{"kind": "growth", "rate_per_hour": 0.02}]}
    >>> plain = {"camera": {"width": 160, "height": 120, "focal_length_px": 2000}, "objects": [sheet]}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "sensor": {"noise_std": 0.01}}
    >>> scene = Scene.from_dict(plain | {"frames": {"count": 5, "frame_interval_s": 60}})
    >>> print(*recommend(scene, predict(scene, method="refined"), growth_alone=True))
    growth of 'sheet' is 0.033 % per frame at a precision of 0.035 % per pixel: raise frames.frame_interval_s to 130
    >>> slower = Scene.from_dict(plain | {"frames": {"count": 5, "frame_interval_s": 130}})
    >>> recommend(slower, predict(slower, method="refined"), growth_alone=True)
    []
    """
    known = limited_objects(scene, Limits()) if parts is None else parts
    causes = prediction.causes
    exact = painting or all(_is_exact(part.item.texture.kind) for part in known)

    def again(changed: Scene) -> Prediction:
        motion = cast(MotionChoice, causes.motion)
        return predict_analytic(changed, prediction.method, causes.window_sigma_px, motion, known, painting=painting)

    return make_recommendations(
        scene,
        prediction,
        again,
        enough=SUFFICIENT_RATIO if exact else 0.5 * SUFFICIENT_RATIO,
        growth_alone=growth_alone,
    )


def _is_exact(kind: str) -> bool:
    return kind not in analytic_spectra() or analytic_spectra()[kind].exact
