"""Warnings from predicted numbers, with the field to change and by how much."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from scenetruth.design.predict.prediction import Figure, Prediction
from scenetruth.scene import Scene

__all__ = ["ENOUGH", "advice"]

ENOUGH = 2.0
"""What there is to be measured should be this many standard deviations."""

# The standard deviation of depth should be less than this share of it.
_DEPTH_SHARE = 0.01
# A window should not be narrower than half a wave: its standard deviation is a quarter of its width.
_WAVES_PER_SIGMA = 8.0
_LEAST_TRANSFER, _LEAST_KNOWN = 0.4, 0.5
# Motion while an image is taken, as a share of the wavelength: beyond, less than two thirds of the contrast are left.
_MOST_BLUR, _BETTER_BLUR = 0.5, 0.3
_WIDEST_PX = 30.0
# What is exactly as bright as full scale may have been rounded up.
_FULL = 1 + 1e-6
# A longer interval moves things to where the texture is seen otherwise.
_NEARLY = 0.9
# Rounding of coarse meshes is no growth.
_NOTHING = 1e-7

Again = Callable[[Scene], Prediction]


def advice(
    scene: Scene,
    prediction: Prediction,
    again: Again,
    *,
    enough: float = ENOUGH,
    growth_alone: bool = False,
) -> list[str]:
    """Return what a prediction warns of, in words.

    Parameters
    ----------
    scene
        The scene.
    prediction
        What is predicted for it.
    again
        Predicts the same of a changed scene: what is advised has been tried.
    enough
        How many standard deviations motion and growth should be.
    growth_alone
        Whether nothing but growth is asked for.

    Returns
    -------
    list of str
        One line for each warning; none if all is well.
    """
    found = list(_of_growth(scene, prediction, again, enough))
    if not growth_alone:
        found += [*_of_motion(scene, prediction, again, enough), *_of_depth(scene, prediction)]
        found += _of_images(scene, prediction)
    return found


def _of_growth(scene: Scene, prediction: Prediction, again: Again, enough: float) -> Iterator[str]:
    region = _most_moving(prediction, "growth_rate")
    if region is None:
        return
    figure = prediction.figure("growth_rate", region)
    if _is_enough(figure, enough):
        return
    signal, std = (100.0 * each for each in (figure.signal or 0.0, figure.std))
    text = f"growth{_of(region)} is {signal:.2g} % per frame at a precision of {std:.2g} % per pixel"
    yield f"{text}: {_longer(scene, region, 'growth_rate', figure, again) or _wider(scene, figure, 2.0)}"


def _of_motion(scene: Scene, prediction: Prediction, again: Again, enough: float) -> Iterator[str]:
    quantity = next((name for name in ("velocity_endpoint", "flow_x") if name in prediction.quantities), None)
    region = None if quantity is None else _most_moving(prediction, quantity)
    if quantity is None or region is None:
        return
    figure = prediction.figure(quantity, region)
    if _is_enough(figure, enough):
        return
    text = f"motion{_of(region)} is {figure.signal:.2g} {figure.unit} at a precision of {figure.std:.2g}"
    yield f"{text}: {_longer(scene, region, quantity, figure, again) or _wider(scene, figure, 1.0)}"


def _of_depth(scene: Scene, prediction: Prediction) -> Iterator[str]:
    if "depth" not in prediction.quantities:
        return
    std, depth = prediction.figure("depth").std, prediction.causes.depth_mm
    if math.isfinite(std) and std > _DEPTH_SHARE * depth:
        # Depth is as precise as the baseline is long.
        enough = _nice(abs(scene.stage.baseline_mm) * std / (_DEPTH_SHARE * depth))
        text = f"depth has a precision of {std:.2g} mm at {depth:.4g} mm, {100 * std / depth:.2g} %"
        yield f"{text}: raise stage.baseline_mm to {enough:g}"
    share = prediction.figure("depth").known_share
    if share < _LEAST_KNOWN:
        text = f"images tell depth in {100 * share:.0f} % of what is seen only"
        yield f"{text}: give surfaces a texture, or reduce stage.baseline_mm, so that all images show them"


def _of_images(scene: Scene, prediction: Prediction) -> Iterator[str]:
    causes = prediction.causes
    sigma = causes.window_sigma_px
    if math.isfinite(causes.wavelength_px) and causes.wavelength_px > _WAVES_PER_SIGMA * sigma:
        text = f"the texture's waves are about {causes.wavelength_px:.0f} px long, and a window's standard deviation "
        text += f"is {sigma:g} px: make the texture's wavelengths shorter, or raise "
        yield text + f"estimate.window_sigma_px to {_nice(causes.wavelength_px / _WAVES_PER_SIGMA):g}"
    objects = {name: one for name, one in prediction.by_region.items() if name.startswith("object_")}
    region = max(objects, key=lambda name: objects[name].brightest_level)
    brightest = objects[region].brightest_level
    if brightest > _FULL:
        remedy = "reduce lighting" if scene.lighting.lit else "let the sensor collect less light"
        yield f"brightest grey values{_of(region)} are at {100 * brightest:.0f} % of full scale, saturated: {remedy}"
    time = scene.shutter.exposure_time_s
    # What rests behind an object that moves blurs nothing, and has waves of its own.
    region = max(objects, key=lambda name: objects[name].blur_px / objects[name].wavelength_px)
    moving = objects[region]
    if moving.blur_px > _MOST_BLUR * moving.wavelength_px and time > 0:
        # What blurs less shows shorter waves.
        shorter = time * _BETTER_BLUR * moving.wavelength_px / moving.blur_px
        text = f"points{_of(region)} move {moving.blur_px:.1f} px while an image is taken, and the texture's waves are "
        yield f"{text}about {moving.wavelength_px:.1f} px long: reduce shutter.exposure_time_s to {shorter:.2g}"
    elif 0 < causes.transfer < _LEAST_TRANSFER:
        text = f"lens and pixels leave {100 * causes.transfer:.0f} % of the texture's contrast"
        yield f"{text}: make its wavelengths longer, or change optics"


def _most_moving(prediction: Prediction, quantity: str) -> str | None:
    """Return the object of which there is most to be measured; None if there is nothing."""
    if quantity not in prediction.quantities:
        return None
    signals = {
        region: prediction.figure(quantity, region).signal or 0.0
        for region in prediction.regions
        if region.startswith("object_")
    }
    best = max(signals, key=lambda region: signals[region], default=None)
    return best if best is not None and signals[best] > _NOTHING else None


def _is_enough(figure: Figure, enough: float) -> bool:
    ratio = figure.signal_to_noise
    return ratio is None or ratio >= enough or not math.isfinite(figure.std)


def _of(region: str) -> str:
    return f" of '{region.removeprefix('object_')}'"


def _longer(scene: Scene, region: str, quantity: str, figure: Figure, again: Again) -> str | None:
    """Return a longer interval, if what is to be measured grows with it."""
    interval = _nice(scene.frames.frame_interval_s * _missing(figure))
    frames = scene.frames.model_copy(update={"frame_interval_s": interval})
    changed = again(scene.model_copy(update={"frames": frames}))
    if region not in changed.regions:
        return None
    ratio = changed.figure(quantity, region).signal_to_noise or 0.0
    # Motion that is given per frame stays as it is.
    if ratio < _NEARLY * ENOUGH:
        return None
    return f"raise frames.frame_interval_s to {interval:g}"


def _wider(scene: Scene, figure: Figure, power: float) -> str:
    """Return another remedy: what is given per frame does not grow with the interval.

    Standard deviations of motion fall with the window's width, those of its gradient with the square of it.
    """
    factor = _missing(figure)
    sigma = getattr(scene.estimate.settings, "window_sigma_px", None)
    if sigma is not None and (wider := _nice(sigma * factor ** (1 / power))) <= _WIDEST_PX:
        return f"raise estimate.window_sigma_px to {wider:g}, or the motion in the scene"
    return f"it takes {factor:.2g} times less noise, or as much more motion: it is given per frame"


def _missing(figure: Figure) -> float:
    """Return how many times more there should be to be measured."""
    return ENOUGH / max(figure.signal_to_noise or 0.0, 1e-9)


def _nice(value: float) -> float:
    """Return the next larger number of two digits."""
    size = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / size - 1e-9) * size:.3g}")
