"""Depth, velocity, disparity, flow, normals, ids and mixed pixels of one camera at one time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.raycast import RayCaster, Topology, mixed_pixels
from scenetruth.scene.world import World

__all__ = ["GeometryPass", "truth_maps"]


class GeometryPass:
    """The world at one time, ready to be looked at from any camera position.

    Parameters
    ----------
    world
        The scene's objects.
    topology
        Faces and edges of the world, from `Topology.of` once for all times.
    t
        Time in frames.
    """

    def __init__(self, world: World, topology: Topology, t: float) -> None:
        self.world = world
        self.snapshot = world.at(t)
        self.caster = RayCaster(self.snapshot.vertices_mm, topology)


def truth_maps(
    geometry: GeometryPass, camera: Camera, viewpoint: Viewpoint, baseline_mm: float
) -> dict[str, NDArray[Any]]:
    """Compute the truth at the pixel centres of one image.

    Parameters
    ----------
    geometry
        The world at the image's time.
    camera
        The camera.
    viewpoint
        Where it stands. Depth, velocity and normals are in its frame.
    baseline_mm
        V_X in mm per step of s, for the disparity.

    Returns
    -------
    dict
        The variables of a truth by name (`scenetruth.recording.VARIABLES`), vector components first:

        - ``depth`` Z in mm, ``velocity`` (U_X, U_Y, U_Z) in mm per frame,
        - ``disparity`` f V_X / Z in px per step (minus the paper's v_x, eq. 5), of the image without distortion,
        - ``flow`` ((f U_X - x U_Z) / Z, (f U_Y - y U_Z) / Z) in px per frame, with x and y from the principal point:
          the paper's (u_x + x u_z, u_y + y u_z); times the slope of the distortion, if the lens has one,
        - ``normal``, ``object_id``, ``face_id``, ``mixed``.
    """
    shape = (camera.height, camera.width)
    directions = camera.ray_directions(camera.pixel_grid()).reshape(-1, 3)
    in_world = viewpoint.directions_to_world(directions)
    hits = geometry.caster.cast(viewpoint.position_mm, in_world, grid_width=camera.width)
    world, focal = geometry.world, camera.focal_px
    depth = hits.depth
    velocity = viewpoint.directions_to_camera(hits.interpolate(world.faces, geometry.snapshot.velocities))
    rates = (velocity[:, :2] - directions[:, :2] * velocity[:, 2:]) / depth[:, None]
    flow = camera.flow_of(directions, rates)
    seen = hits.face >= 0
    body = np.where(seen, world.face_body[hits.face], -1).astype(np.int32)
    face_id = np.where(seen, hits.face - world.face_offsets[world.face_body[hits.face]], -1).astype(np.int32)
    mixed = mixed_pixels(geometry.caster, viewpoint, camera, body.reshape(shape))
    normals = viewpoint.directions_to_camera(_normals(geometry, hits.face, in_world))
    return {
        "depth": depth.reshape(shape),
        "velocity": np.moveaxis(velocity.reshape(*shape, 3), -1, 0),
        "disparity": (focal * baseline_mm / depth).reshape(shape),
        "flow": np.moveaxis(flow.reshape(*shape, 2), -1, 0),
        "normal": np.moveaxis(normals.reshape(*shape, 3), -1, 0),
        "object_id": body.reshape(shape),
        "face_id": face_id.reshape(shape),
        "mixed": mixed,
    }


def _normals(geometry: GeometryPass, face: NDArray[np.int32], directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return unit normals of the faces that are seen, turned towards the camera; NaN for none."""
    corners = geometry.snapshot.vertices_mm[geometry.world.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = normals[face]
    away = np.einsum("ij,ij->i", seen, directions) > 0
    seen[away] *= -1
    seen[face < 0] = np.nan
    return seen
