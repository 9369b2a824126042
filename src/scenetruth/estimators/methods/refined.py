"""Method ``refined``: least-squares fit of all images to a surface that moves, rotates and grows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from scenetruth.errors import Problem
from scenetruth.estimators.method_settings import LEAST_ACCELERATED, RefinedSettings
from scenetruth.estimators.protocol import Needs, StreamingMethod
from scenetruth.progress import Progress
from scenetruth.schema import Put

if TYPE_CHECKING:
    import xarray as xr

__all__ = []


class _Refined(StreamingMethod):
    """Depth, slopes, 3D motion and growth of every pixel from all images together."""

    name = "refined"
    settings = RefinedSettings
    gives: frozenset[str] = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(images=2, grid=True, exclusion_mask=True, distortion=True, schedule=True)
    # Of the finite elements, 5 x 9 images of 640 x 480, which fit most motion models; time scaled by that of the cube.
    bytes_per_pixel = 4700.0
    pixels_at_once = 1.0
    # As in `FIT_LIMITS`; maps, initial fields, and what the C library retains.
    whole_pixels = 4e5
    tile_pixels = 1.8e5
    bytes_per_tiled_pixel = 170.0
    seconds_per_sample = 3.3e-5

    def requirements(self, recording: xr.Dataset, settings: RefinedSettings) -> list[Problem]:
        from scenetruth.estimators.refined.lens_distortion import lens_problems

        sizes = recording["image"].sizes
        if settings.initialisation == "structure_tensor":
            from scenetruth.estimators.method_settings import StructureTensorSettings
            from scenetruth.estimators.structure_tensor.filters import axis_problems

            axes = axis_problems(StructureTensorSettings(), sizes["s"], sizes["t"], sizes["x"], sizes["y"])
            return [*lens_problems(recording), *axes]
        problems = lens_problems(recording)
        if sizes["s"] == 1 and 1 in (settings.window_frames, sizes["t"]):
            message = "one camera determines motion only, which requires two frames"
            problems.append(Problem("window_frames", message, min(settings.window_frames, sizes["t"])))
        frames = min(settings.window_frames, sizes["t"])
        if settings.accelerated and frames < LEAST_ACCELERATED:
            message = f"requires a window of at least {LEAST_ACCELERATED} frames; this window has {frames} frames"
            problems.append(Problem("acceleration", message, value=True))
        least = 2 * math.ceil(2 * settings.window_sigma_px) + 1
        for name, size in (("camera.width", sizes["x"]), ("camera.height", sizes["y"])):
            if size < least:
                message = f"must be at least {least} px, the width of a window; reduce window_sigma_px"
                problems.append(Problem(name, message, size))
        places = recording["stage_x_mm"].values
        if sizes["s"] == 1 and sizes.get("s_y", 1) > 1:
            message = "cameras in one column have no disparity along x for the initial estimate; use 2 positions"
            problems.append(Problem("stage.positions", message, 1))
        if sizes["s"] > 1 and not np.isclose(places, 0.0, atol=1e-9).any():
            message = "requires a camera at 0, the reference of the estimate, or initialisation: structure_tensor"
            problems.append(Problem("stage_x_mm", message, places.tolist()))
        return problems

    def blank(self, recording: xr.Dataset, settings: RefinedSettings) -> xr.Dataset:
        from scenetruth.estimators.refined.method import blank_estimate

        return blank_estimate(recording, settings)

    def fill(
        self, recording: xr.Dataset, settings: RefinedSettings, put: Put, progress: Progress | None
    ) -> Mapping[str, Any]:
        from scenetruth.estimators.refined.method import fill_estimate

        return fill_estimate(recording, settings, put, progress)


METHOD = _Refined()
