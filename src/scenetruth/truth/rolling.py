"""Truth of an image whose rows are exposed one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene.world import World
from scenetruth.truth.maps import GeometryPass, truth_maps

__all__ = ["truth_by_rows"]


def truth_by_rows(
    world: World,
    topology: Topology,
    camera: Camera,
    times: NDArray[np.float64],
    viewpoints: Sequence[Viewpoint],
    baseline_mm: float,
) -> dict[str, NDArray[Any]]:
    """Compute the truth of every row at its own time and from its own viewpoint.

    Parameters
    ----------
    world, topology
        The scene's objects, and their faces and edges.
    camera
        The camera.
    times
        Time of every row in frames, shape (height,).
    viewpoints
        Where the camera stands at these times.
    baseline_mm
        V_X in mm per step of s.

    Returns
    -------
    dict
        As `truth_maps`; flow and velocity are instantaneous, at the row's time.
    """
    maps: dict[str, NDArray[Any]] = {}
    for row, (time, viewpoint) in enumerate(zip(times.tolist(), viewpoints, strict=True)):
        # A row above and one below, as rays at the border need neighbours to be exact.
        part = truth_maps(GeometryPass(world, topology, time), camera.rows(row - 1, row + 2), viewpoint, baseline_mm)
        for name, values in part.items():
            if name not in maps:
                maps[name] = np.empty((*values.shape[:-2], camera.height, camera.width), dtype=values.dtype)
            maps[name][..., row, :] = values[..., 1, :]
    return maps
