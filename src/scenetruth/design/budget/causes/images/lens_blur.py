"""The lens's point spread in focus."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np

from scenetruth.camera.optics import AiryPsf, GaussianPsf
from scenetruth.design.budget.blur import growing_blur
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Disturbance, Sight
from scenetruth.scene import Scene


class LensBlur(Cause):
    """A point spread that has the same size in px wherever the object is.

    What comes nearer is seen larger, and less blurred in proportion. Of a blur with the variance σ², an image that is
    larger by ε shows the texture changed by - ε σ² ∇²T.
    """

    kind = "lens_blur"
    title = "blur of the lens"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"optics.psf": None}
    takes_contrast = True
    coarse = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the width of the point spread."""
        psf = scene.optics.psf
        return "" if psf is None else f"{np.sqrt(_variance(psf)):.2g} px"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the change of contrast with the object's distance."""
        psf = sight.scene.optics.psf
        if psf is not None:
            variance = _variance(psf)
            yield growing_blur(sight, lambda closer, depth: -2 * closer * variance)

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return a wider aperture, or another lens."""
        words = "a wider aperture (optics.psf.f_number)" if isinstance(scene.optics.psf, AiryPsf) else "a better lens"
        return Remedy(f"{words}, half as blurred", {self.kind: 0.25})


def _variance(psf: GaussianPsf | AiryPsf) -> float:
    # Airy's disc has no variance; that of the Gaussian that fits its core.
    return float(psf.finest_px**2)
