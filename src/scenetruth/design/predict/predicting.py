"""The prediction of a scene's precision."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, cast

from scenetruth.bound.model import Motion
from scenetruth.design.predict.advice import ENOUGH, advice
from scenetruth.design.predict.envelope import envelope
from scenetruth.design.predict.prediction import Level, Prediction
from scenetruth.design.predict.textures.base import spectra
from scenetruth.errors import Problem, SceneError
from scenetruth.resources import Limits, Part, bounded_parts
from scenetruth.scene import Scene, load_scene, scene_from_plain

__all__ = ["advise", "predict", "predict_in_passing", "scene_of"]


def predict(
    scene: Scene | Mapping[str, Any] | str | PathLike[str],
    level: Level = "envelope",
    method: str = "refined",
    window_sigma_px: float | None = None,
    motion: Motion | None = None,
    *,
    limits: Limits | None = None,
) -> Prediction:
    """Predict how precisely depth, slopes, motion and growth of a scene can be known, without drawing any noise.

    Parameters
    ----------
    scene
        The scene, its plain values, or its file.
    level
        ``"envelope"``: from geometry and the spectrum of the texture, in milliseconds. ``"bound"``: from one rendered
        image without noise and the exact truth, in seconds, with maps.
    method
        The method of estimation: ``"refined"`` or ``"structure_tensor"``. If the scene estimates with it, its settings
        are the scene's.
    window_sigma_px
        Standard deviation of the window in px; that of the method's settings if not given.
    motion
        What is unknown of how velocity changes in a window: ``"translation"``, ``"rigid"``, ``"growing"`` or
        ``"affine"``; that of the method's settings if not given.
    limits
        Bounds of what the scene may ask for (`scenetruth.Limits`); those by default if not given.

    Returns
    -------
    Prediction
        Standard deviations by region and quantity, and what went into them.

    Raises
    ------
    SceneError
        If the scene cannot be made or passes a bound, nothing of it is seen, its sensor has no noise, or an argument is
        impossible; lists all that is wrong.

    See Also
    --------
    scenetruth.bound.cramer_rao : The bound of a recording whose truth is known.

    Examples
    --------
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 600]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    >>> plain = {"camera": {"width": 160, "height": 120, "focal_length_px": 2000}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "frames": {"count": 5}, "sensor": {"noise_std": 0.01}}
    >>> prediction = predict(plain)
    >>> depth = prediction.figure("depth")
    >>> f"{depth.value:.2f} {depth.value_unit}"
    '0.04 mm'
    """
    if level not in ("envelope", "bound"):
        raise SceneError([Problem("level", "must be envelope or bound", level)])
    known, folder = scene_of(scene)
    parts = bounded_parts(known, limits or Limits(), folder)
    made = envelope(known, method, window_sigma_px, motion, parts, folder)
    if level == "envelope":
        return made
    # Compiled code is loaded for this one alone.
    from scenetruth.design.predict.bounded import bounded

    return bounded(known, method, window_sigma_px, motion, made)


def predict_in_passing(scene: Scene, parts: Sequence[Part], method: str) -> Prediction:
    """Predict the precision of a scene by formulas alone: no compiled code is loaded, and no texture painted.

    Parameters
    ----------
    scene, parts
        The scene and its objects.
    method
        The method.
    """
    return envelope(scene, method, None, None, parts, painting=False)


def advise(
    scene: Scene,
    prediction: Prediction,
    parts: Sequence[Part] | None = None,
    *,
    painting: bool = True,
    growth_alone: bool = False,
) -> list[str]:
    """Return what a prediction warns of: too little precision, and which field to change by how much.

    Parameters
    ----------
    scene
        The scene.
    prediction
        What is predicted for it.
    parts
        Its objects, if they are at hand.
    painting
        Whether textures without a formula may be painted. If not, what is predicted of them is too large, and only
        what cannot be seen at all is warned of.
    growth_alone
        Whether nothing but growth is asked for.

    Returns
    -------
    list of str
        One line for each warning; none if all is well.

    See Also
    --------
    predict : The prediction.

    Examples
    --------
    A sheet that grows by 2 % per hour, seen every minute, and then as seldom as is advised:

    >>> from scenetruth.design.predict import advise, predict
    >>> sheet = {"name": "sheet", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 600]}}
    >>> sheet |= {"texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    >>> sheet |= {"deformation": [{"kind": "growth", "rate_per_hour": 0.02}]}
    >>> plain = {"camera": {"width": 160, "height": 120, "focal_length_px": 2000}, "objects": [sheet]}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "sensor": {"noise_std": 0.01}}
    >>> scene = scene_from_plain(plain | {"frames": {"count": 5, "frame_interval_s": 60}})
    >>> print(*advise(scene, predict(scene), growth_alone=True))
    growth of 'sheet' is 0.033 % per frame at a precision of 0.033 % per pixel: raise frames.frame_interval_s to 120
    >>> slower = scene_from_plain(plain | {"frames": {"count": 5, "frame_interval_s": 120}})
    >>> advise(slower, predict(slower), growth_alone=True)
    []
    """
    known = bounded_parts(scene, Limits()) if parts is None else parts
    causes = prediction.causes
    exact = painting or all(_is_exact(part.item.texture.kind) for part in known)

    def again(changed: Scene) -> Prediction:
        motion = cast("Motion", causes.motion)
        return envelope(changed, prediction.method, causes.window_sigma_px, motion, known, painting=painting)

    return advice(scene, prediction, again, enough=ENOUGH if exact else 0.5 * ENOUGH, growth_alone=growth_alone)


def _is_exact(kind: str) -> bool:
    return kind not in spectra() or spectra()[kind].exact


def scene_of(scene: Scene | Mapping[str, Any] | str | PathLike[str]) -> tuple[Scene, Path]:
    """Return a scene that is given in any form, and the folder that its relative paths count from."""
    if isinstance(scene, Scene):
        return scene, Path()
    if isinstance(scene, Mapping):
        return scene_from_plain(dict(scene)), Path()
    # Paths in scene files that were loaded are absolute.
    return load_scene(Path(scene)), Path()
