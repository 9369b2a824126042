"""The truth of an image with a rolling shutter, whose rows are exposed one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.raycast import Topology
from scenetruth.scene.world import World
from scenetruth.truth.maps import GeometryPass, TruthMaps, boundary_distance, truth_maps

__all__ = ["truth_by_rows"]


def truth_by_rows(
    world: World,
    topology: Topology,
    camera: Camera,
    times: NDArray[np.float64],
    viewpoints: Sequence[Viewpoint],
    baseline_mm: float,
    maps: TruthMaps = "complete",
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
        Poses of the camera at these times.
    baseline_mm
        V_X in mm per step of s.
    maps
        Which maps; see `truth_maps`.

    Returns
    -------
    dict
        As `truth_maps`; flow and velocity are instantaneous, at the row's time.
    """
    found: dict[str, NDArray[Any]] = {}
    for row, (time, viewpoint) in enumerate(zip(times.tolist(), viewpoints, strict=True)):
        # A row above and one below, as rays at the border need neighbours to be exact.
        geometry = GeometryPass(world, topology, time)
        part = truth_maps(geometry, camera.rows(row - 1, row + 2), viewpoint, baseline_mm, maps)
        for name, values in part.items():
            if name not in found:
                found[name] = np.empty((*values.shape[:-2], camera.height, camera.width), dtype=values.dtype)
            found[name][..., row, :] = values[..., 1, :]
    # The nearest mixed pixel may be in another row.
    return found | {"boundary_distance": boundary_distance(found["mixed"])}
