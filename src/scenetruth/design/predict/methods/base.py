"""What is told of a method: which window and motion it has, and how its noise relates to the bound."""

from __future__ import annotations

import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.geometry import Views
from scenetruth.bound.model import Motion
from scenetruth.design.predict.look import Look
from scenetruth.design.predict.seen import Seen
from scenetruth.errors import Problem, SceneError
from scenetruth.estimators import MethodChoice, choose
from scenetruth.provenance import intrinsics_from
from scenetruth.scene import Scene
from scenetruth.schema import Intrinsics

if TYPE_CHECKING:
    from scenetruth.design.predict.rendered import Rendered

__all__ = ["MethodModel", "Setup", "modelled", "setup_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Setup:
    """A method with its settings, and the rig.

    Parameters
    ----------
    scene
        The scene; its lens without distortion.
    settings
        Of the method.
    window_sigma_px
        Standard deviation of the window.
    motion
        What is unknown of the velocity gradient.
    views
        Images that are estimated together, those of the window's frames around the reference frame.
    """

    scene: Scene
    settings: Any
    window_sigma_px: float
    motion: Motion
    views: Views

    @property
    def intrinsics(self) -> Intrinsics:
        """Of camera and stage."""
        return intrinsics_from(self.scene)

    @property
    def sees_depth(self) -> bool:
        """Whether there is more than one camera."""
        return len(np.unique(np.stack([self.views.s, self.views.s_y]), axis=1).T) > 1

    @property
    def sees_motion(self) -> bool:
        """Whether there is more than one frame."""
        return len(np.unique(self.views.t)) > 1


class MethodModel(ABC):
    """A method of estimation as theory knows it."""

    name: ClassVar[str]
    """Its name."""

    @abstractmethod
    def motion_of(self, settings: Any) -> Motion:
        """Return what it does not know of the velocity gradient, by its settings."""

    @abstractmethod
    def frames_of(self, settings: Any, count: int) -> int:
        """Return how many frames it looks at together, of a recording of so many."""

    @abstractmethod
    def from_spectrum(self, setup: Setup, look: Look, seen: Seen) -> dict[str, Array]:
        """Return standard deviations of what it estimates at points, from the texture's spectrum.

        Parameters
        ----------
        setup
            Its settings and the rig.
        look, seen
            The points, and what images show of them.

        Returns
        -------
        dict
            ``disparity``, ``depth``, ``slope.0``, ``flow.0``, ``velocity.0`` ... ``growth_rate``, in the units of data
            sets, as far as it tells them; each of shape (n,), not finite where nothing is told.
        """

    @abstractmethod
    def from_images(self, setup: Setup, scene: Rendered) -> dict[str, Array]:
        """Return maps of standard deviations, from an image of the texture without noise.

        Parameters
        ----------
        setup
            Its settings and the rig.
        scene
            The image, the truth and the noise.

        Returns
        -------
        dict
            As of `from_spectrum`, each of shape (y, x); noise that stays with the pixels is not in it.
        """


@cache
def modelled() -> Mapping[str, MethodModel]:
    """Return the methods that theory knows, by name."""
    from scenetruth.design.predict import methods

    found = {}
    for entry in pkgutil.iter_modules(methods.__path__):
        module = import_module(f"{methods.__name__}.{entry.name}")
        for one in vars(module).values():
            own = isinstance(one, type) and issubclass(one, MethodModel) and one.__module__ == module.__name__
            if own and one is not MethodModel:
                found[one.name] = one()
    return found


def setup_of(scene: Scene, method: str, window_sigma_px: float | None, motion: Motion | None) -> Setup:
    """Return a method at work on a scene.

    Parameters
    ----------
    scene
        The scene. If it estimates with this method, it has its settings.
    method
        Name of the method.
    window_sigma_px, motion
        Instead of what the settings say.

    Raises
    ------
    SceneError
        If the method is not one that theory knows, or the window is impossible; lists all.
    """
    problems = []
    if method not in modelled():
        message = f"theory knows the precision of {', '.join(modelled())} only"
        problems.append(Problem("method", message, method))
    if window_sigma_px is not None and not 0.5 <= window_sigma_px <= 100:
        problems.append(Problem("window_sigma_px", "must be 0.5 to 100 px", window_sigma_px))
    if motion not in (None, "translation", "rigid", "growing", "affine"):
        problems.append(Problem("motion", "must be one of translation, rigid, growing, affine", motion))
    if problems:
        raise SceneError(problems)
    model = modelled()[method]
    chosen: MethodChoice = scene.estimate if scene.estimate.method == method else choose({"method": method})
    settings: Any = chosen.settings
    sigma = float(settings.window_sigma_px if window_sigma_px is None else window_sigma_px)
    pinhole = scene.model_copy(update={"camera": scene.camera.without_distortion()})
    views = _views(scene, model.frames_of(settings, scene.frames.count))
    return Setup(pinhole, settings, sigma, model.motion_of(settings) if motion is None else motion, views)


def within(views: Views, frames: int) -> Views:
    """Return the images of so many frames around the reference."""
    kept = np.abs(views.t) <= max(frames - 1, 1) / 2 if frames > 1 else views.t == 0
    return replace(views, s=views.s[kept], s_y=views.s_y[kept], t=views.t[kept], frame_of=views.frame_of[kept])


def _views(scene: Scene, frames: int) -> Views:
    stage = scene.stage
    rows, along = stage.y_mm / stage.baseline_mm, stage.x_mm / stage.baseline_mm
    times = scene.frames.t.astype(np.float64)
    index = np.stack(np.meshgrid(*(np.arange(len(part)) for part in (rows, along, times)), indexing="ij"), axis=-1)
    numbers = index.reshape(-1, 3)
    views = Views(along[numbers[:, 1]], rows[numbers[:, 0]], times[numbers[:, 2]], numbers)
    return views if frames >= scene.frames.count else within(views, frames)
