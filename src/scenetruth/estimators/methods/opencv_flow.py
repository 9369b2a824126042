"""Optical flow of the reference camera by OpenCV: Farnebäck's method, or dense inverse search."""

from __future__ import annotations

import numpy as np
import xarray as xr

from scenetruth.errors import Problem
from scenetruth.estimators import opencv
from scenetruth.estimators.protocol import Method, Needs
from scenetruth.progress import Progress
from scenetruth.schema import make_estimate

__all__ = ["METHOD"]


class _OpencvFlow(Method):
    """Optical flow from every frame to the next, for all frames but the last.

    References
    ----------
    G. Farnebäck: Two-Frame Motion Estimation Based on Polynomial Expansion. SCIA 2003.
    T. Kroeger et al.: Fast Optical Flow Using Dense Inverse Search. ECCV 2016.
    """

    name = "opencv_flow"
    settings = opencv.FlowSettings
    gives = frozenset({"flow"})
    needs = Needs(frames=2, channels=1)

    def requirements(self, recording: xr.Dataset, settings: opencv.FlowSettings) -> list[Problem]:
        return opencv.cv2_problems()

    def estimate(self, recording: xr.Dataset, settings: opencv.FlowSettings, progress: Progress | None) -> xr.Dataset:
        frames = list(range(recording.sizes["t"] - 1))
        found = opencv.flows(recording, opencv.eight_bit_images(recording), settings, frames, progress)
        return make_estimate(like=recording, flow=np.stack(found, axis=1), t=recording["t"].values[:-1])


METHOD = _OpencvFlow()
