"""Depth from two cameras by OpenCV's block matching, semi-global or local."""

from __future__ import annotations

import numpy as np
import xarray as xr

from scenetruth.errors import Problem
from scenetruth.estimators import opencv
from scenetruth.estimators.protocol import Method, Needs
from scenetruth.progress import Progress
from scenetruth.schema import make_estimate

__all__ = ["METHOD"]


class _OpencvStereo(Method):
    """Disparity between the reference and one other camera, for every frame.

    References
    ----------
    H. Hirschmüller: Stereo Processing by Semiglobal Matching and Mutual Information. IEEE Transactions on Pattern
    Analysis and Machine Intelligence 30, 2008.
    """

    name = "opencv_stereo"
    settings = opencv.StereoSettings
    gives = frozenset({"depth", "disparity"})
    needs = Needs(cameras=2, channels=1)

    def requirements(self, recording: xr.Dataset, settings: opencv.StereoSettings) -> list[Problem]:
        return [*opencv.cv2_problems(), *opencv.camera_problems(recording, settings)]

    def estimate(self, recording: xr.Dataset, settings: opencv.StereoSettings, progress: Progress | None) -> xr.Dataset:
        frames = range(recording.sizes["t"])
        found = opencv.disparities(recording, opencv.eight_bit_images(recording), settings, list(frames), progress)
        return make_estimate(like=recording, disparity=np.stack(found), t=recording["t"].values)


METHOD = _OpencvStereo()
