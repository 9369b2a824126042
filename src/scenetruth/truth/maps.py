"""Depth, velocity, disparity, flow, normals, ids and mixed pixels of one camera at one time."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint, pixel_rays
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

    @cached_property
    def normals(self) -> NDArray[np.float64]:
        """Unit normals of all faces in the world, by the order of their corners, shape (m, 3)."""
        corners = self.snapshot.vertices_mm[self.world.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # A face without an area is met by no ray.
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        return normals


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
    from scenetruth.truth.kernels import fill_maps

    shape = (camera.height, camera.width)
    directions = pixel_rays(camera).directions
    in_world = viewpoint.directions_to_world(directions)
    hits = geometry.caster.cast(viewpoint.position_mm, in_world, grid_width=camera.width)
    world, focal = geometry.world, camera.focal_px
    velocity, flow, disparity, normal, body, face_id = fill_maps(
        hits.face,
        hits.depth,
        hits.weights,
        directions,
        world.faces,
        viewpoint.directions_to_camera(geometry.snapshot.velocities),
        viewpoint.directions_to_camera(geometry.normals),
        world.face_body,
        world.face_offsets,
        focal if camera.distortion is None else 1.0,
        focal * baseline_mm,
    )
    if camera.distortion is not None:
        flow = np.ascontiguousarray(camera.flow_of(directions, flow.T).T)
    mixed = mixed_pixels(geometry.caster, viewpoint, camera, body.reshape(shape))
    return {
        "depth": hits.depth.reshape(shape),
        "velocity": velocity.reshape(3, *shape),
        "disparity": disparity.reshape(shape),
        "flow": flow.reshape(2, *shape),
        "normal": normal.reshape(3, *shape),
        "object_id": body.reshape(shape),
        "face_id": face_id.reshape(shape),
        "mixed": mixed,
    }
