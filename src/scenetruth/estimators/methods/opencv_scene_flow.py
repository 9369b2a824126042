"""Depth and 3D motion from OpenCV's stereo and optical flow put together."""

from __future__ import annotations

import numpy as np
import xarray as xr

from scenetruth.errors import Problem
from scenetruth.estimators import opencv
from scenetruth.estimators.protocol import Method, Needs
from scenetruth.progress import Progress
from scenetruth.schema import make_estimate

__all__ = ["METHOD"]


class _Settings(opencv.StereoSettings, opencv.FlowSettings):
    """How OpenCV matches the two images of a pair, and how it finds the flow from a frame to the next."""


class _OpencvSceneFlow(Method):
    """Stereo in every frame, flow from every frame to the next; U_Z is the change of depth along the flow."""

    name = "opencv_scene_flow"
    settings = _Settings
    gives = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(cameras=2, frames=2, channels=1)

    def requirements(self, recording: xr.Dataset, settings: _Settings) -> list[Problem]:
        return [*opencv.cv2_problems(), *opencv.camera_problems(recording, settings)]

    def estimate(self, recording: xr.Dataset, settings: _Settings, progress: Progress | None) -> xr.Dataset:
        images = opencv.eight_bit_images(recording)
        frames = list(range(recording.sizes["t"]))
        disparity = np.stack(opencv.disparities(recording, images, settings, frames, progress))
        forward = opencv.flows(recording, images, settings, frames[:-1], progress)
        # Of the last frame there is no flow, but its depth tells where the points before it went.
        flow = np.stack([*forward, np.full_like(forward[0], np.nan)], axis=1)
        found = make_estimate(like=recording, disparity=disparity, flow=flow, t=recording["t"].values)
        return found.isel(t=slice(None, -1))


METHOD = _OpencvSceneFlow()
