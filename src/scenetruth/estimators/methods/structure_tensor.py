"""The paper's method: one 4D structure tensor gives disparity and 3D motion."""

from __future__ import annotations

import xarray as xr

from scenetruth.errors import Problem
from scenetruth.estimators.protocol import Method, Needs
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings
from scenetruth.progress import Progress

__all__ = ["METHOD"]


class _StructureTensor(Method):
    name = "structure_tensor"
    settings = StructureTensorSettings
    gives = frozenset({"depth", "disparity", "flow", "velocity"})
    needs = Needs(images=2)

    def requirements(self, recording: xr.Dataset, settings: StructureTensorSettings) -> list[Problem]:
        from scenetruth.estimators.structure_tensor.rig import requirements

        sizes = recording["image"].sizes
        return requirements(settings, sizes["s"], sizes["t"], sizes["x"], sizes["y"])

    def estimate(
        self, recording: xr.Dataset, settings: StructureTensorSettings, progress: Progress | None
    ) -> xr.Dataset:
        from scenetruth.estimators.structure_tensor.method import estimate_structure_tensor

        return estimate_structure_tensor(recording, settings, progress)


METHOD = _StructureTensor()
