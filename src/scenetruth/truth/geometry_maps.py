"""Exact maps of one image: depth, motion, growth and surface point at each pixel centre, also for a rolling shutter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint, pixel_rays
from scenetruth.raycast import Hits, RayCaster, Topology, image_hits, mixed_pixels
from scenetruth.scene.built_scene import BuiltScene

if TYPE_CHECKING:
    from scenetruth.truth.layer_kernels import Layers

__all__ = ["Geometries", "GeometryPass", "LightProvider", "TruthMaps", "truth_by_rows", "truth_maps"]


TruthMaps = Literal["standard", "complete", "complete_with_light"]


class _LightAtHits(Protocol):
    def on_hits(
        self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], hits: Hits
    ) -> Mapping[str, NDArray[np.float64]]:
        """Return maps of light at the hits of rays in the world, by name, shape (n,) each."""
        ...


LightProvider = Callable[[RayCaster, float], _LightAtHits]
"""Returns the light on the surfaces at a time in frames; the ground truth itself has no model of light."""


class GeometryPass:
    """Geometry of a scene at time t in frames, for maps of any camera.

    ``provider``: Light of the scene, for maps of light.
    """

    def __init__(self, world: BuiltScene, topology: Topology, t: float, provider: LightProvider | None = None) -> None:
        self.world = world
        self.snapshot = world.at(t)
        self.caster = RayCaster(self.snapshot.vertices_mm, topology)
        self._provider = provider
        self._layers: dict[tuple[Camera, bytes, bytes, tuple[float, float]], Layers] = {}

    def layers(self, camera: Camera, viewpoint: Viewpoint, vertices: NDArray[np.float64]) -> Layers:
        """Return where the image of a camera shows a single layer of surface; its vertices are in the camera frame."""
        from scenetruth.truth.layer_kernels import find_layers

        key = (camera, viewpoint.position_mm.tobytes(), viewpoint.rotation.tobytes(), viewpoint.shear)
        found = self._layers.get(key)
        if found is None:
            pinhole, topology = (camera.focal_px, *camera.principal_point), self.caster.topology
            found = self._layers[key] = find_layers(
                vertices,
                topology.faces,
                topology.sides_across,
                self._convex,
                self.world.face_offsets,
                pinhole,
                camera.width,
                camera.height,
            )
        return found

    @cached_property
    def _convex(self) -> NDArray[np.bool_]:
        """Faces of convex bodies, shape (m,)."""
        from scenetruth.truth.layer_kernels import find_convex_faces

        topology = self.caster.topology
        across, offsets = topology.sides_across, self.world.face_offsets
        found: NDArray[np.bool_] = find_convex_faces(self.caster.vertices_mm, topology.faces, across, offsets)
        return found

    @cached_property
    def light(self) -> _LightAtHits:
        """Light on the surfaces."""
        assert self._provider is not None, "maps of light require the light of the scene"
        return self._provider(self.caster, self.snapshot.t)

    @cached_property
    def surface_tensors(self) -> NDArray[np.float64]:
        """Shape and motion tensors of all surface points (`BuiltScene.surface_at`), shape (k, 18)."""
        return self.world.surface_at(self.snapshot.t)

    @cached_property
    def rates(self) -> NDArray[np.float64]:
        """Diagonal of the rate of deformation at all surface points, shape (k, 3)."""
        found = self.snapshot.rates
        return self.world.rates_at(self.snapshot.t) if found is None else found


class Geometries:
    """Geometry of a scene at any time, with a cache of the most recent ``kept`` times, for several threads."""

    def __init__(self, world: BuiltScene, topology: Topology, kept: int, provider: LightProvider | None = None) -> None:
        self.world, self.topology, self._provider = world, topology, provider
        self._kept = kept
        self._passes: dict[float, GeometryPass] = {}
        self._lock = Lock()

    def at(self, t: float) -> GeometryPass:
        """Return the geometry at a time in frames."""
        with self._lock:
            found = self._passes.pop(t, None) or GeometryPass(self.world, self.topology, t, self._provider)
            # Most recently used entry last.
            self._passes[t] = found
            while len(self._passes) > self._kept:
                del self._passes[next(iter(self._passes))]
        return found


def truth_maps(
    geometry: GeometryPass, camera: Camera, viewpoint: Viewpoint, baseline_mm: float, maps: TruthMaps = "complete"
) -> dict[str, NDArray[Any]]:
    """Compute the ground truth at the pixel centres of one image.

    Returns: Variables of a ground truth by name (`scenetruth.schema.VARIABLES`), vector components first. From the
    visible triangle, and therefore mutually consistent to rounding: motion, depth, normal, slope, identity and
    coordinates, and

    - ``disparity`` f V_X / Z in px per step (minus the paper's v_x, eq. 5), of the undistorted image,
    - ``flow`` ((f U_X - x U_Z) / Z, (f U_Y - y U_Z) / Z) in px per frame, with x and y relative to the principal point:
      the paper's (u_x + x u_z, u_y + y u_z); with lens distortion, times its Jacobian.

    From the smooth surface, interpolated between exact values at the vertices: curvature, rotation rate and growth
    rates; principal values are ordered from the larger to the smaller. From the light of the scene: radiance, its
    shares, and the fraction of light that arrives.
    """
    from scenetruth.truth.map_kernels import MovingMesh, fill_maps, fill_surface_maps

    shape = (camera.height, camera.width)
    directions = pixel_rays(camera).directions
    in_world = viewpoint.directions_to_world(directions)
    world, focal = geometry.world, camera.focal_px
    # The image has the same rays.
    known = image_hits(world).take(geometry.snapshot.t, camera, viewpoint)
    if known is None:
        hits = geometry.caster.cast(viewpoint.position_mm, in_world, grid_width=camera.width)
    else:
        hits = geometry.caster.hit_faces(viewpoint.position_mm, in_world, known.face)
    velocity, flow, disparity, normal, body, face_id = fill_maps(
        hits.face,
        hits.depth,
        hits.weights,
        directions,
        MovingMesh(
            world.faces,
            viewpoint.directions_to_camera(geometry.snapshot.velocities),
            viewpoint.directions_to_camera(geometry.caster.face_normals),
            world.face_body,
            world.face_offsets,
        ),
        focal if camera.distortion is None else 1.0,
        focal * baseline_mm,
    )
    if camera.distortion is not None:
        flow = np.ascontiguousarray(camera.compute_flow(directions, flow.T).T)
    mixed = mixed_pixels(geometry.caster, viewpoint, camera, body.reshape(shape)) if known is None else known.mixed
    barycentric = np.where(hits.face >= 0, hits.weights.T, np.nan)
    curvature, rotation, growth, principal, direction = fill_surface_maps(
        hits.face,
        hits.weights,
        normal,
        world.surface_corners,
        geometry.rates if maps == "standard" else geometry.surface_tensors,
        viewpoint.rotation.T,
        maps != "standard",
    )
    found: dict[str, NDArray[Any]] = {
        "depth": hits.depth,
        "velocity": velocity,
        "disparity": disparity,
        "flow": flow,
        "normal": normal,
        "object_id": body,
        "face_id": face_id,
        "barycentric": barycentric,
        "growth_rate": growth,
    }
    if maps != "standard":
        accelerations = viewpoint.directions_to_camera(geometry.snapshot.accelerations)
        # Faces parallel to the optical axis have slopes that are infinite or undefined.
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = -normal[:2] / normal[2]
        found |= {
            "acceleration": hits.interpolate(world.faces, accelerations).T,
            "slope": slope,
            "curvature": curvature,
            "rotation_rate": rotation,
            "principal_growth_rates": principal,
            "principal_growth_direction": direction,
            "uv": hits.interpolate_corners(world.image_uv).T,
            "material_coordinates_mm": hits.interpolate_corners(world.chart_mm).T,
        }
    if maps == "complete_with_light":
        found |= geometry.light.on_hits(viewpoint.position_mm, in_world, hits)
    found = {name: values.reshape(*values.shape[:-1], *shape) for name, values in found.items()}
    return _with_distances(found | {"mixed": mixed})


def _with_distances(maps: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the maps of one image with the distances to silhouettes and, if there are maps of light, to shadows."""
    found = maps | {"boundary_distance": boundary_distance(maps["mixed"])}
    if "lit_fraction" in maps:
        # Of cameras with bands, a border in any of them.
        bands = maps["lit_fraction"].reshape(-1, *maps["mixed"].shape)
        borders = [shadow_borders(lit_fraction, maps["object_id"], maps["mixed"]) for lit_fraction in bands]
        found["shadow_distance"] = boundary_distance(np.any(borders, axis=0))
    return found


_SHADOW_STEP = 0.01  # change of the lit fraction between neighbouring pixels in penumbrae of 100 px


def shadow_borders(
    lit_fraction: NDArray[np.float64], object_id: NDArray[np.int32], mixed: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the pixels between which and a neighbour on the same surface the lit fraction changes by 0.01 or more."""
    found = np.zeros(mixed.shape, dtype=np.bool_)
    for axis in (0, 1):
        first, second = ((slice(None),) * axis + (part,) for part in (slice(None, -1), slice(1, None)))
        # Comparisons with NaN are false.
        changed = np.abs(lit_fraction[first] - lit_fraction[second]) >= _SHADOW_STEP
        changed &= (object_id[first] == object_id[second]) & ~mixed[first] & ~mixed[second]
        found[first] |= changed
        found[second] |= changed
    return found


def boundary_distance(mixed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the distance in px to the nearest marked pixel, shape (height, width), infinite if there is none."""
    if not mixed.any():
        return np.full(mixed.shape, np.inf)
    from scenetruth.truth.map_kernels import distances

    found: NDArray[np.float64] = distances(mixed)
    return found


def truth_by_rows(
    world: BuiltScene,
    topology: Topology,
    camera: Camera,
    times: NDArray[np.float64],
    viewpoints: Sequence[Viewpoint],
    baseline_mm: float,
    maps: TruthMaps = "complete",
    provider: LightProvider | None = None,
) -> dict[str, NDArray[Any]]:
    """Compute the ground truth of every row at its own time (frames) and viewpoint."""
    found: dict[str, NDArray[Any]] = {}
    for row, (time, viewpoint) in enumerate(zip(times.tolist(), viewpoints, strict=True)):
        # Include one row above and one below, because exact hits at the border need neighbouring rays.
        geometry = GeometryPass(world, topology, time, provider)
        part = truth_maps(geometry, camera.rows(row - 1, row + 2), viewpoint, baseline_mm, maps)
        for name, values in part.items():
            if name not in found:
                found[name] = np.empty((*values.shape[:-2], camera.height, camera.width), dtype=values.dtype)
            found[name][..., row, :] = values[..., 1, :]
    # The nearest mixed pixel may be in another row.
    return _with_distances(found)
