"""Method of the paper: disparity and scene flow from one 4D structure tensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from scenetruth.errors import Problem
from scenetruth.estimators.method_settings import StructureTensorSettings
from scenetruth.estimators.protocol import Needs, StreamingMethod
from scenetruth.progress import Progress
from scenetruth.schema import Put

if TYPE_CHECKING:
    import xarray as xr

__all__ = []


class _StructureTensor(StreamingMethod):
    """Disparity, depth and 3D motion of every pixel from the derivatives of all images, by one 4D structure tensor."""

    name = "structure_tensor"
    settings = StructureTensorSettings
    gives = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(images=2)

    def requirements(self, recording: xr.Dataset, settings: StructureTensorSettings) -> list[Problem]:
        from scenetruth.estimators.structure_tensor.filters import axis_problems

        sizes = recording["image"].sizes
        return axis_problems(settings, sizes["s"], sizes["t"], sizes["x"], sizes["y"])

    def blank(self, recording: xr.Dataset, settings: StructureTensorSettings) -> xr.Dataset:
        from scenetruth.estimators.structure_tensor.method import blank_estimate

        return blank_estimate(recording, settings)

    def fill(
        self, recording: xr.Dataset, settings: StructureTensorSettings, put: Put, progress: Progress | None
    ) -> Mapping[str, Any]:
        from scenetruth.estimators.structure_tensor.method import fill_estimate

        return fill_estimate(recording, settings, put, progress)


METHOD = _StructureTensor()
