"""Optical flow of the reference camera by OpenCV: Farnebäck's method or dense inverse search."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from scenetruth.errors import Problem
from scenetruth.estimators import opencv_common
from scenetruth.estimators.protocol import Needs, StreamingMethod
from scenetruth.progress import Progress
from scenetruth.schema import Put, blank_estimate, put_each

if TYPE_CHECKING:
    import xarray as xr

__all__ = []


class _OpencvFlow(StreamingMethod):
    """Optical flow from every frame to the next, for all frames except the last.

    References
    ----------
    G. Farnebäck: Two-Frame Motion Estimation Based on Polynomial Expansion. SCIA 2003.
    T. Kroeger et al.: Fast Optical Flow Using Dense Inverse Search. ECCV 2016.
    """

    name = "opencv_flow"
    settings = opencv_common.FlowSettings
    gives = frozenset({"flow"})
    needs = Needs(frames=2, channels=1)

    def requirements(self, recording: xr.Dataset, settings: opencv_common.FlowSettings) -> list[Problem]:
        return opencv_common.cv2_problems()

    def blank(self, recording: xr.Dataset, settings: opencv_common.FlowSettings) -> xr.Dataset:
        return blank_estimate(["flow"], recording=recording, t=recording["t"].values[:-1])

    def fill(
        self, recording: xr.Dataset, settings: opencv_common.FlowSettings, put: Put, progress: Progress | None
    ) -> Mapping[str, Any]:
        images = opencv_common.eight_bit_images(recording)
        put_each("flow", opencv_common.flows(recording, images, settings, progress), put, recording=recording)
        return {}


METHOD = _OpencvFlow()
