"""The refined method: a least-squares fit of all images, which reaches the Cramér-Rao bound of its windows."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from scenetruth.bound.evaluate import bound_maps
from scenetruth.bound.model import Model, Motion, Surface
from scenetruth.design.predict.information import deviations
from scenetruth.design.predict.look import Look
from scenetruth.design.predict.methods.base import MethodModel, Setup
from scenetruth.design.predict.seen import Seen
from scenetruth.estimators.refined.settings import RefinedSettings

if TYPE_CHECKING:
    from scenetruth.design.predict.rendered import Rendered

__all__ = ["RefinedModel"]

Array = NDArray[np.float64]


class RefinedModel(MethodModel):
    """Its noise is that of the bound with its own window: a plane, and what the motion leaves unknown."""

    name: ClassVar[str] = "refined"

    def motion_of(self, settings: RefinedSettings) -> Motion:
        """Return what it does not know of the velocity gradient; of ``auto``, what it takes where that does."""
        return "growing" if settings.motion == "auto" else settings.motion

    def frames_of(self, settings: RefinedSettings, count: int) -> int:
        """Return how many frames it looks at together."""
        return min(settings.window_frames, count)

    def from_spectrum(self, setup: Setup, look: Look, seen: Seen) -> dict[str, Array]:
        """Return standard deviations from the texture's spectrum; see `MethodModel`."""
        if not (setup.sees_depth or setup.sees_motion):
            return {}
        place = look.points.place(*(each[:, None] for each in (setup.views.s, setup.views.s_y, setup.views.t)))
        camera = setup.scene.camera
        c_x, c_y = camera.principal_point
        shown = (np.abs(place.x + c_x - (camera.width - 1) / 2) <= camera.width / 2) & (
            np.abs(place.y + c_y - (camera.height - 1) / 2) <= camera.height / 2
        )
        return deviations(look, setup.views, shown, seen, setup.window_sigma_px, model_of(setup), setup.intrinsics)

    def from_images(self, setup: Setup, scene: Rendered) -> dict[str, Array]:
        """Return maps from an image without noise; see `MethodModel`."""
        if not (setup.sees_depth or setup.sees_motion):
            return {}
        return bound_maps(scene.truth, scene.recording, scene.noise, model_of(setup), setup.window_sigma_px)


def model_of(setup: Setup) -> Model:
    """Return what is unknown in the windows of a fit."""
    surface: Surface = "constant" if setup.settings.surface == "constant" else "plane"
    return Model(surface, setup.motion, moving=setup.sees_motion, brightness=0, stereo=setup.sees_depth)
