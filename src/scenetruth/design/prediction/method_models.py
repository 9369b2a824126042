"""Models of estimation methods: analysis window, motion model, and noise propagation."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.cramer_rao import bound_maps
from scenetruth.bound.fisher_information import GROWTH_BIAS
from scenetruth.bound.motion_selection import combine_motion_models, is_biased
from scenetruth.bound.surface_geometry import ImageTimes
from scenetruth.bound.unknowns import Motion, MotionChoice, Surface, WindowUnknowns
from scenetruth.design.prediction.surface_samples import SurfaceSamples
from scenetruth.design.prediction.texture_information import (
    ImagedTexture,
    compute_deviations,
    compute_flow,
    compute_moments,
)
from scenetruth.discovery import classes_in
from scenetruth.errors import Problem, SceneError
from scenetruth.estimators import MethodChoice, choose
from scenetruth.estimators.method_settings import RefinedSettings, StructureTensorSettings
from scenetruth.estimators.structure_tensor.filters import (
    PAPER,
    AcquisitionAxes,
    choose_acquisition_axes,
    gaussian_window,
    transfer,
)
from scenetruth.provenance import intrinsics_from
from scenetruth.scene import Scene
from scenetruth.schema import Intrinsics

if TYPE_CHECKING:
    from scenetruth.design.prediction.reference_render import ReferenceRender

__all__ = ["MethodModel", "MethodSetup", "RefinedModel", "StructureTensorModel", "all_method_models", "prepare_method"]


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MethodSetup:
    """An estimation method with its settings, applied to a scene."""

    scene: Scene  # without lens distortion
    settings: Any
    window_sigma_px: float
    motion: Motion
    views: ImageTimes  # images of the window's frames around the reference frame, estimated together
    automatic: bool = False  # whether the affine model replaces the motion model where growth is anisotropic

    @property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics of camera and stage."""
        return intrinsics_from(self.scene)

    @property
    def sees_depth(self) -> bool:
        """Whether there are several cameras."""
        return len(np.unique(np.stack([self.views.s, self.views.s_y]), axis=1).T) > 1

    @property
    def sees_motion(self) -> bool:
        """Whether there are several frames."""
        return len(np.unique(self.views.t)) > 1


class MethodModel(ABC):
    """Model of the uncertainty of an estimation method."""

    name: ClassVar[str]
    """Name of the method."""

    @abstractmethod
    def get_motion_model(self, settings: Any) -> Motion:
        """Return the motion model of the method: its unknowns of the velocity gradient."""

    def chooses_motion_model(self, settings: Any) -> bool:
        """Return whether the method changes to the affine motion model where growth is anisotropic."""
        return False

    @abstractmethod
    def count_frames(self, settings: Any, count: int) -> int:
        """Return the number of frames estimated together, of a recording of ``count`` frames."""

    @abstractmethod
    def from_spectrum(self, setup: MethodSetup, look: SurfaceSamples, seen: ImagedTexture) -> dict[str, Array]:
        """Return standard deviations at points, from the spectrum of the texture.

        Returns: ``disparity``, ``depth``, ``slope.0``, ``flow.0``, ``velocity.0`` ... ``growth_rate``, in the units of
        data sets, as far as the method estimates them; each of shape (n,), not finite where undetermined.
        """

    @abstractmethod
    def from_images(self, setup: MethodSetup, scene: ReferenceRender) -> dict[str, Array]:
        """Return maps (y, x) of standard deviations by temporal noise, from a noise-free image; see `from_spectrum`."""


@cache
def all_method_models() -> Mapping[str, MethodModel]:
    """Return the method models by name."""
    return {cls.name: cls() for cls in classes_in(MethodModel, __name__)}


def prepare_method(
    scene: Scene, method: str, window_sigma_px: float | None, motion: MotionChoice | None
) -> MethodSetup:
    """Return the setup of a method for a scene; without ``motion``, the motion model is that of its settings."""
    problems = []
    if method not in all_method_models():
        message = f"precision can be predicted for {', '.join(all_method_models())} only"
        problems.append(Problem("method", message, method))
    if window_sigma_px is not None and not 0.5 <= window_sigma_px <= 100:
        problems.append(Problem("window_sigma_px", "must be 0.5 to 100 px", window_sigma_px))
    if motion is not None and motion not in get_args(MotionChoice):
        problems.append(Problem("motion", f"must be one of {', '.join(get_args(MotionChoice))}", motion))
    if problems:
        raise SceneError(problems)
    model = all_method_models()[method]
    chosen: MethodChoice = scene.estimate if scene.estimate.method == method else choose({"method": method})
    settings: Any = chosen.settings
    sigma = float(settings.window_sigma_px if window_sigma_px is None else window_sigma_px)
    pinhole = scene.model_copy(update={"camera": scene.camera.without_distortion()})
    views = _views(scene, model.count_frames(settings, scene.frames.count))
    if motion == "auto" and "motion" in type(settings).model_fields:
        settings = settings.model_copy(update={"motion": "auto"})
    elif motion is not None and motion != "auto":
        return MethodSetup(pinhole, settings, sigma, motion, views)
    automatic = model.chooses_motion_model(settings)
    return MethodSetup(pinhole, settings, sigma, model.get_motion_model(settings), views, automatic)


def select_frames(views: ImageTimes, frames: int) -> ImageTimes:
    """Return the images of a number of frames around the reference."""
    kept = np.abs(views.t) <= max(frames - 1, 1) / 2 if frames > 1 else views.t == 0
    return replace(views, s=views.s[kept], s_y=views.s_y[kept], t=views.t[kept], frame_of=views.frame_of[kept])


def _views(scene: Scene, frames: int) -> ImageTimes:
    stage = scene.stage
    rows, along = stage.y_mm / stage.baseline_mm, stage.x_mm / stage.baseline_mm
    times = scene.frames.t.astype(np.float64)
    index = np.stack(np.meshgrid(*(np.arange(len(part)) for part in (rows, along, times)), indexing="ij"), axis=-1)
    numbers = index.reshape(-1, 3)
    views = ImageTimes(along[numbers[:, 1]], rows[numbers[:, 0]], times[numbers[:, 2]], numbers)
    return views if frames >= scene.frames.count else select_frames(views, frames)


class RefinedModel(MethodModel):
    """Cramér-Rao bound with the window of the method: a plane, and the unknowns of its motion model."""

    name: ClassVar[str] = "refined"

    def get_motion_model(self, settings: RefinedSettings) -> Motion:
        """Return the motion model; for ``auto``, the model used where growth is isotropic."""
        return "growing" if settings.motion == "auto" else settings.motion

    def chooses_motion_model(self, settings: RefinedSettings) -> bool:
        """Return whether anisotropic growth changes the motion model."""
        return settings.motion == "auto" and settings.surface != "constant"

    def count_frames(self, settings: RefinedSettings, count: int) -> int:
        """Return the number of frames estimated together."""
        return min(settings.window_frames, count)

    def from_spectrum(self, setup: MethodSetup, look: SurfaceSamples, seen: ImagedTexture) -> dict[str, Array]:
        """Return standard deviations from the texture spectrum; see `MethodModel`."""
        if not (setup.sees_depth or setup.sees_motion):
            return {}
        place = look.points.place(*(each[:, None] for each in (setup.views.s, setup.views.s_y, setup.views.t)))
        camera = setup.scene.camera
        c_x, c_y = camera.principal_point
        shown = (np.abs(place.x + c_x - (camera.width - 1) / 2) <= camera.width / 2) & (
            np.abs(place.y + c_y - (camera.height - 1) / 2) <= camera.height / 2
        )

        unknowns = window_unknowns(setup)

        def predicted(model: WindowUnknowns, *, biased: bool = False) -> dict[str, Array]:
            return compute_deviations(
                look, setup.views, shown, seen, setup.window_sigma_px, model, setup.intrinsics, biased=biased
            )

        found = predicted(unknowns, biased=setup.automatic)
        if not is_biased(found):
            found.pop(GROWTH_BIAS, None)
            return found
        return combine_motion_models(
            found, predicted(replace(unknowns, motion="affine")), look.neighbourhood(setup.window_sigma_px)
        )

    def from_images(self, setup: MethodSetup, scene: ReferenceRender) -> dict[str, Array]:
        """Return maps from a noise-free image; see `MethodModel`."""
        if not (setup.sees_depth or setup.sees_motion):
            return {}

        found = bound_maps(
            scene.truth,
            scene.recording,
            scene.noise,
            window_unknowns(setup),
            setup.window_sigma_px,
            selected=setup.automatic,
        )
        alone = ~_shows_half_of_window(setup.views, scene.truth.sel(t=0)["disparity"].values, setup.window_sigma_px)
        return {name: np.where(alone, np.nan, values) for name, values in found.items()}


def _shows_half_of_window(views: ImageTimes, disparity: Array, sigma_px: float) -> NDArray[np.bool_]:
    """Return where the second of two cameras shows at least half of the window; elsewhere `refined` is invalid."""
    cameras = np.unique(np.stack([views.s, views.s_y], axis=1), axis=0)
    if len(cameras) != _PAIR:
        return np.ones(disparity.shape, dtype=np.bool_)
    s, s_y = cameras[np.argmax(np.abs(cameras).sum(axis=1))]
    height, width = disparity.shape
    y, x = np.indices(disparity.shape, dtype=np.float64)
    known = np.isfinite(disparity)
    shift = np.where(known, disparity, 0.0)
    column, row = x - s * shift, y - s_y * shift
    inside = known & (column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)
    from scipy.ndimage import gaussian_filter

    shares = [gaussian_filter(each.astype(np.float64), sigma_px) for each in (inside, known)]
    return np.asarray(shares[0] >= _LEAST_SHOWN * shares[1])


_PAIR, _LEAST_SHOWN = 2, 0.5


def window_unknowns(setup: MethodSetup) -> WindowUnknowns:
    """Return the unknowns in the windows of a fit."""
    surface: Surface = "constant" if setup.settings.surface == "constant" else "plane"
    return WindowUnknowns(surface, setup.motion, moving=setup.sees_motion, brightness=0, stereo=setup.sees_depth)


Sums = dict[tuple[int, int], Array]

_HIGHEST_POWER = 2
_PAIRS = ((0, 0), (0, 1), (1, 1))  # pairs of gradient components
# Registrations that are tried, relative to the nearest disparity: others may give a lower variance of the divergence.
_OFF = (0, -1, 1, -2, 2)
_LEAST_DETERMINANT = 1e-9  # least determinant of a matrix with unit diagonal
_STEP_PX = 0.25  # resolution of residual disparities


class _Texture(NamedTuple):
    """Sums over windows of products of gradients, for noise and information.

    Products xx, xy and yy, by the powers of the distance. ``normal`` is weighted by the window, the others by its
    square, with gradients smoothed once more, or differentiated once more along x or y. ``change`` and
    ``change_smoothed`` refer to the change along x between cameras, without powers of the distance.
    """

    normal: list[Sums]
    smoothed: list[Sums]
    along_x: list[Sums]
    along_y: list[Sums]
    change: Array
    change_smoothed: Array


class _At(NamedTuple):
    """Positions of windows, and the noise there."""

    x: Array
    y: Array
    depth: Array
    disparity: Array
    flow: Array
    velocity: Array
    noise: Array
    pattern: Array
    shared: Callable[[Array, Array], Array | float]
    """Factor by which filters along s and t reduce the variance of fixed-pattern noise."""


class StructureTensorModel(MethodModel):
    """Least squares of g_s, and of g_t, by g_x, g_y and x g_x + y g_y, with the noise passed by the filters.

    To first order in the noise, total least squares equals least squares. With a = (g_x, g_y, ξ g_x + η g_y + h), the
    window w, and the filtered noise e,

        Cov p = (Σ w a aᵀ)⁻¹ Σ Σ w w' a a'ᵀ <e e'> (Σ w a aᵀ)⁻¹

    The noise is smoothed along x and y like the gradients, so the double sum equals a single sum with w² and gradients
    smoothed once more. Along s and t it has the energy of the filters, with the window along t. h is the contribution
    of each camera's coordinate x - D s if a disparity v remains after registration by D: for a wave of wave number k,
    D Σ S_s s sin(k v s) times its gradient. The registration with the lowest variance of the divergence is used.
    """

    name: ClassVar[str] = "structure_tensor"

    def get_motion_model(self, settings: StructureTensorSettings) -> Motion:
        """Return the motion model: no velocity gradient, since growth is interpreted as approach."""
        return "translation"

    def count_frames(self, settings: StructureTensorSettings, count: int) -> int:
        """Return the number of frames estimated together."""
        return choose_acquisition_axes(np.arange(3.0) - 1.0, count, settings).frames

    def from_spectrum(self, setup: MethodSetup, look: SurfaceSamples, seen: ImagedTexture) -> dict[str, Array]:
        """Return standard deviations from the texture spectrum; see `MethodModel`."""
        rig = _load_axes(setup)
        turn = 2 * np.pi * seen.frequency
        derivative, smoothing = (np.asarray(each) for each in transfer(turn))
        gradient = np.stack([derivative[..., 0] * smoothing[..., 1], smoothing[..., 0] * derivative[..., 1]], axis=-1)
        smooth = smoothing[..., 0] * smoothing[..., 1]
        windows = compute_moments(look, setup.window_sigma_px, _HIGHEST_POWER)
        points = look.points

        def sums(moments: Sums, factor: Array) -> list[Sums]:
            found = []
            for k, m in _PAIRS:
                mean = (seen.variance * gradient[..., k] * gradient[..., m] * factor**2).sum(axis=1)
                found.append({powers: mean * moment for powers, moment in moments.items()})
            return found

        def textured(left: Array) -> _Texture:
            phase = turn[..., 0, None] * left[:, None, None] * rig.over_s.nodes
            # Residual disparity blurs the mean over the cameras.
            kept = (rig.over_s.smoothing * np.cos(phase)).sum(axis=-1)
            odd = (rig.over_s.smoothing * rig.over_s.nodes * np.sin(phase)).sum(axis=-1)
            change = seen.variance * (gradient[..., 0] * odd) ** 2
            return _Texture(
                sums(windows[0], kept),
                sums(windows[1], kept * smooth),
                sums(windows[1], kept * gradient[..., 0]),
                sums(windows[1], kept * gradient[..., 1]),
                change.sum(axis=1) * windows[0][0, 0],
                (change * smooth**2).sum(axis=1) * windows[1][0, 0],
            )

        velocity = points.q * setup.scene.stage.baseline_mm
        weight = seen.variance * np.square(gradient).sum(axis=-1) * smooth**2
        shared = partial(_shared, look, turn, weight, rig, setup.window_sigma_px)
        flow = compute_flow(look).T
        at = _At(points.x, points.y, look.depth_mm, points.d, flow, velocity, seen.noise, seen.pattern, shared)
        return _deviations(setup, rig, at, textured)

    def from_images(self, setup: MethodSetup, scene: ReferenceRender) -> dict[str, Array]:
        """Return maps from a noise-free image; see `MethodModel`.

        Residual disparity is assumed to blur all products like the square of the gradient along x.
        """
        from scipy.ndimage import correlate1d

        rig, settings = _load_axes(setup), setup.settings
        truth = scene.truth.sel(t=0)
        along_d, along_s = PAPER.derivative, PAPER.smoothing

        def filtered(image: Array, over_x: Array, over_y: Array) -> Array:
            return np.asarray(correlate1d(correlate1d(image, over_x, axis=1), over_y, axis=0))

        gradient = filtered(scene.level_map, along_d, along_s), filtered(scene.level_map, along_s, along_d)
        own = setup.window_sigma_px == settings.window_sigma_px
        taps = settings.window_taps_px if own else 2 * math.ceil(2 * setup.window_sigma_px) + 1
        line = gaussian_window(setup.window_sigma_px, taps)
        distance = np.arange(len(line)) - len(line) // 2

        def window(product: Array, weights: Array, j: int, i: int) -> Array:
            return filtered(product, weights * distance**j, weights * distance**i)

        def sums(parts: Sequence[Array], weights: Array) -> list[Sums]:
            return [
                {
                    (j, i): window(parts[k] * parts[m], weights, j, i)
                    for j in range(_HIGHEST_POWER + 1)
                    for i in range(_HIGHEST_POWER + 1 - j)
                }
                for k, m in _PAIRS
            ]

        normal = sums(gradient, line)
        smoothed = sums([filtered(each, along_s, along_s) for each in gradient], line**2)
        along_x = sums([filtered(each, along_d, along_s) for each in gradient], line**2)
        along_y = sums([filtered(each, along_s, along_d) for each in gradient], line**2)
        turn = 2 * np.pi * np.fft.rfftfreq(gradient[0].shape[1])
        spectrum = np.fft.rfft(gradient[0], axis=1)

        @cache
        def changes(step: int) -> tuple[Array, Array, Array, Array]:
            # Residual disparity between cameras blurs their mean, and causes changes from camera to camera.
            phase = turn[:, None] * (step * _STEP_PX) * rig.over_s.nodes
            mean = (rig.over_s.smoothing * np.cos(phase)).sum(axis=1)
            odd = 1j * (rig.over_s.smoothing * rig.over_s.nodes * np.sin(phase)).sum(axis=1)
            found = []
            for factor in (mean, odd):
                one = np.fft.irfft(spectrum * factor, gradient[0].shape[1], axis=1)
                found += [window(one**2, line, 0, 0), window(filtered(one, along_s, along_s) ** 2, line**2, 0, 0)]
            return found[0], found[1], found[2], found[3]

        def textured(left: Array) -> _Texture:
            step = np.rint(np.abs(np.nan_to_num(left)) / _STEP_PX).astype(np.int64)
            entries = np.zeros((4, *step.shape))
            for one in np.unique(step).tolist():
                here = step == one
                for total, values in zip(entries, changes(one), strict=True):
                    total[here] = values[here]
            blur, blur_smoothed = entries[0] / changes(0)[0], entries[1] / changes(0)[1]
            return _Texture(
                _scaled(normal, blur),
                _scaled(smoothed, blur_smoothed),
                _scaled(along_x, blur_smoothed),
                _scaled(along_y, blur_smoothed),
                entries[2],
                entries[3],
            )

        c_x, c_y = setup.scene.camera.principal_point
        x, y = np.meshgrid(truth["x"].values - c_x, truth["y"].values - c_y)
        at = _At(
            x,
            y,
            truth["depth"].values,
            truth["disparity"].values,
            truth["flow"].values,
            truth["velocity"].values,
            scene.noise_map,
            np.zeros_like(scene.pattern_map),
            lambda *_: 0.0,
        )
        found = _deviations(setup, rig, at, textured)
        return {name: np.where(np.isfinite(truth["depth"].values), values, np.nan) for name, values in found.items()}


def _deviations(
    setup: MethodSetup, rig: AcquisitionAxes, at: _At, textured: Callable[[Array], _Texture]
) -> dict[str, Array]:
    """Return the standard deviations of disparity, depth, flow and velocity in windows."""
    focal, found = setup.scene.camera.focal_px, dict[str, Array]()
    relative: Array = np.zeros_like(at.x)
    nearest = np.rint(at.disparity) if setup.sees_depth else np.zeros_like(at.x)
    left = at.disparity - nearest if setup.sees_depth else np.zeros_like(at.x)
    texture = textured(left)
    if setup.sees_depth:
        inverse = _inverse(_matrix(texture.normal))
        along, smooth = (
            _energy(at, each, np.convolve(rig.window_t, rig.over_t.smoothing))
            for each in (rig.over_s.derivative, rig.over_s.smoothing)
        )
        scatter = _times(along, _matrix(texture.smoothed)) + _times(smooth * left**2, _matrix(texture.along_x))
        found["disparity"] = np.sqrt((inverse @ scatter @ inverse)[..., 0, 0])
        relative = found["disparity"] / np.abs(at.disparity)
        found["depth"] = at.depth * relative
    if not setup.sees_motion:
        return found
    left_x, left_y = at.flow - np.rint(at.flow)
    along, smooth = (
        _energy(at, rig.over_s.smoothing, np.convolve(rig.window_t, each))
        for each in (rig.over_t.derivative, rig.over_t.smoothing)
    )
    best: Array | None = None
    for off in _OFF if setup.sees_depth else _OFF[:1]:
        tried = texture if off == 0 else textured(left - off)
        own = (nearest + off) ** 2 if setup.sees_depth else np.zeros_like(at.x)
        inverse = _inverse(_matrix(tried.normal, own * tried.change))
        scatter = _times(along, _matrix(tried.smoothed, own * tried.change_smoothed))
        scatter += _times(smooth * left_x**2, _matrix(tried.along_x))
        scatter += _times(smooth * left_y**2, _matrix(tried.along_y))
        covariance = inverse @ scatter @ inverse
        if off == 0:
            found |= {f"flow.{k}": np.sqrt(covariance[..., k, k]) for k in range(2)}
        if best is None:
            best = covariance.copy()
        else:
            better = covariance[..., 2, 2] < best[..., 2, 2]
            best[better] = covariance[better]
    assert best is not None
    if setup.sees_depth:
        nearer = best[..., 2, 2]
        for k, place in enumerate((at.x, at.y)):
            own = found[f"flow.{k}"] ** 2 - 2 * place * best[..., k, 2] + place**2 * nearer
            found[f"velocity.{k}"] = np.sqrt((at.depth / focal) ** 2 * own + (at.velocity[k] * relative) ** 2)
        found["velocity.2"] = np.sqrt(at.depth**2 * nearer + (at.velocity[2] * relative) ** 2)
    return found


def _load_axes(setup: MethodSetup) -> AcquisitionAxes:
    settings: Any = setup.settings
    return choose_acquisition_axes(np.unique(setup.views.s), setup.scene.frames.count, settings)


def _scaled(products: list[Sums], factor: Array) -> list[Sums]:
    return [{powers: factor * values for powers, values in each.items()} for each in products]


def _energy(at: _At, over_s: Array, over_t: Array) -> Array:
    """Return the variance of the noise after filtering along s and t."""
    new = np.square(over_s).sum() * np.square(over_t).sum()
    kept = at.shared(over_s, over_t) if at.pattern.any() else 0.0
    return np.asarray(at.noise**2 * new + at.pattern**2 * kept)


def _shared(
    look: SurfaceSamples,
    turn: Array,
    weight: Array,
    rig: AcquisitionAxes,
    sigma_px: float,
    over_s: Array,
    over_t: Array,
) -> Array:
    """Return the factor by which filters along s and t reduce the variance of fixed-pattern noise.

    Images that show the surface displaced by Δ share this noise by the autocorrelation at Δ of the texture gradient and
    of the window: for waves, filters along s pass |Σ_s f_s exp(i k d s)|².
    """
    # A fixed seed: predictions are deterministic.
    scattered = turn[..., 0] + np.random.default_rng(0).normal(0.0, 1.0 / (np.sqrt(2.0) * sigma_px), turn.shape[:2])
    by_s = (scattered * look.points.d[:, None])[..., None] * rig.positions
    by_t = np.einsum("nwk,nk->nw", turn, compute_flow(look))[..., None] * np.arange(len(over_t))
    left = weight.copy()
    for filtered, phase in ((over_s, by_s), (over_t, by_t)):
        left *= np.abs((filtered * np.exp(1j * phase)).sum(axis=-1)) ** 2
    return np.asarray(left.sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300))


def _inverse(matrices: Array) -> Array:
    """Return inverse matrices; NaN where the texture does not determine all three unknowns."""
    scale = np.sqrt(np.abs(np.einsum("...ii->...i", matrices)))
    scaled = matrices / (scale[..., :, None] * scale[..., None, :])
    known = np.isfinite(scaled).all(axis=(-2, -1))
    safe = np.where(known[..., None, None], scaled, np.eye(3))
    known &= np.linalg.det(safe) > _LEAST_DETERMINANT
    inverse = np.linalg.inv(np.where(known[..., None, None], safe, np.eye(3)))
    inverse[~known] = np.nan
    return np.asarray(inverse / (scale[..., :, None] * scale[..., None, :]))


def _times(factor: Array, matrices: Array) -> Array:
    return np.asarray(factor[..., None, None] * matrices)


def _matrix(products: list[Sums], change: Array | float = 0.0) -> Array:
    """Return Σ w a aᵀ of a = (g_x, g_y, ξ g_x + η g_y + h), shape (..., 3, 3)."""
    xx, xy, yy = products
    one, right, down = (0, 0), (1, 0), (0, 1)
    rows = [
        [xx[one], xy[one], xx[right] + xy[down]],
        [xy[one], yy[one], xy[right] + yy[down]],
        [xx[right] + xy[down], xy[right] + yy[down], xx[2, 0] + 2 * xy[1, 1] + yy[0, 2] + change],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
