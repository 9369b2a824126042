"""Depth from two cameras by semi-global or local block matching of OpenCV."""

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


class _OpencvStereo(StreamingMethod):
    """Disparity between the reference and one other camera, for every frame.

    References
    ----------
    H. Hirschmüller: Stereo Processing by Semiglobal Matching and Mutual Information. IEEE Transactions on Pattern
    Analysis and Machine Intelligence 30, 2008.
    """

    name = "opencv_stereo"
    settings = opencv_common.StereoSettings
    gives = frozenset({"depth", "disparity"})
    needs = Needs(cameras=2, channels=1)

    def requirements(self, recording: xr.Dataset, settings: opencv_common.StereoSettings) -> list[Problem]:
        return [*opencv_common.cv2_problems(), *opencv_common.camera_problems(recording, settings)]

    def blank(self, recording: xr.Dataset, settings: opencv_common.StereoSettings) -> xr.Dataset:
        return blank_estimate(["disparity"], recording=recording, t=recording["t"].values)

    def fill(
        self, recording: xr.Dataset, settings: opencv_common.StereoSettings, put: Put, progress: Progress | None
    ) -> Mapping[str, Any]:
        images = opencv_common.eight_bit_images(recording)
        put_each(
            "disparity", opencv_common.disparities(recording, images, settings, progress), put, recording=recording
        )
        return {}


METHOD = _OpencvStereo()
