"""Depth and scene flow from stereo matching and optical flow of OpenCV."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from scenetruth.errors import Problem
from scenetruth.estimators import opencv_common
from scenetruth.estimators.protocol import Needs, StreamingMethod
from scenetruth.progress import Progress
from scenetruth.schema import Put, assemble_estimate, blank_estimate, compute_depth_rate, put_estimate

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["METHOD"]


class _Settings(opencv_common.StereoSettings, opencv_common.FlowSettings):
    """Settings of the stereo matching and of the optical flow."""


class _OpencvSceneFlow(StreamingMethod):
    """Stereo in every frame, flow from every frame to the next; U_Z is the change of depth along the flow."""

    name = "opencv_scene_flow"
    settings = _Settings
    gives = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(cameras=2, frames=2, channels=1)

    def requirements(self, recording: xr.Dataset, settings: _Settings) -> list[Problem]:
        return [*opencv_common.cv2_problems(), *opencv_common.camera_problems(recording, settings)]

    def blank(self, recording: xr.Dataset, settings: _Settings) -> xr.Dataset:
        return blank_estimate(["disparity", "flow", "depth_rate"], recording=recording, t=recording["t"].values[:-1])

    def fill(
        self, recording: xr.Dataset, settings: _Settings, put: Put, progress: Progress | None
    ) -> Mapping[str, Any]:
        images = opencv_common.eight_bit_images(recording)
        disparities = opencv_common.disparities(recording, images, settings, progress)
        # Disparities of a frame, of the previous and of the next frame.
        near = {0: next(disparities)}
        for place, flow in enumerate(opencv_common.flows(recording, images, settings, progress)):
            near[1] = next(disparities)
            rate = compute_depth_rate(near, flow, recording=recording)
            found = assemble_estimate(
                recording=recording, disparity=near[0], flow=flow, depth_rate=rate, t=recording["t"].values[place]
            )
            put_estimate(found, place, put)
            near = {-1: near[0], 0: near[1]}
        return {}


METHOD = _OpencvSceneFlow()
