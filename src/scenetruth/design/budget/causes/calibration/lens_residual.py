"""Distortion of the lens that images still have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np

from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause, Remedy
from scenetruth.design.budget.sight import Change, Disturbance, Map, Sight
from scenetruth.scene import Scene


class LensResidual(Cause):
    """Points are shown elsewhere than a pinhole would show them, by amounts that differ over the image."""

    kind = "lens_residual"
    title = "distortion of the lens"
    group = "calibration"
    perfect: ClassVar[Mapping[str, Any]] = {"camera.distortion": None}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the largest shift in a corner."""
        camera = scene.camera
        if camera.distortion is None:
            return ""
        corner = np.array([0.0, 0.0]) - camera.principal_point
        off = camera.distortion.distort(corner / camera.focal_px) * camera.focal_px - corner
        return f"{np.linalg.norm(off):.2g} px in a corner"

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give the difference of the shift between each image and the reference."""
        distortion = sight.scene.camera.distortion
        if distortion is None:
            return
        focal = sight.intrinsics.focal_length_px

        def shift(x: Map, y: Map) -> Map:
            points = np.stack([x, y], axis=-1) / focal
            return (distortion.distort(points) - points) * focal

        here = shift(sight.points.x, sight.points.y)

        def change(s: int, t: int) -> Change:
            place = sight.place(s, t)
            off = shift(place.x, place.y) - here
            return Change(off[..., 0], off[..., 1])

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return a calibrated lens."""
        return Remedy("images without distortion: calibrate the lens, and undistort them", {self.kind: 0.05})
