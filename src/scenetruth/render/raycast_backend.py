"""Ray-casting backend (reference): surface points in float64, textures averaged over pixel footprints by quadrature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import BandFraction, as_number
from scenetruth.camera import Camera, Viewpoint, pixel_rays
from scenetruth.raycast import (
    FirstFaces,
    Hits,
    ImageRays,
    RayCaster,
    ShadowCaster,
    TexturedMesh,
    Topology,
    image_hits,
    mixed_pixels,
    scene_topology,
)
from scenetruth.render.renderer import Renderer
from scenetruth.render.sampling_rules import Rule, even_rule, gauss_rule, lattice_rule, square_rule
from scenetruth.render.shading import FaceLight, Shader
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lighting

__all__ = [
    "BandRenderer", "RayView", "RaycastRenderer", "RepeatingRayCaster", "SharedSurfaces", "even_rule", "gauss_rule",
    "lattice_rule", "visible_uv",
]  # fmt: skip


def visible_uv(world: BuiltScene, caster: RayCaster, origin_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the texture coordinates at the corners of all faces, for the side visible from a point.

    The front of a face is the side of its normal (p1 - p0) x (p2 - p0), from which its corners run counter-clockwise.
    """
    if world.uv_back is world.uv:
        return world.uv
    _normals, front = caster.sides(origin_mm)
    return np.where(front[:, None, None], world.uv, world.uv_back)


_FINER = 12  # finer sampling of pixels that a step crosses, per axis
_STEP = 1e-3  # difference of two rules, in units of radiance, from which a pixel is sampled finer
_PIXELS_PER_PIECE = 1 << 16
_RAYS_PER_PIECE = 1 << 19
_MOST_KEPT_BYTES = 1 << 29  # of the arguments and results that the bands of an image have in common


@dataclass(frozen=True, eq=False)
class RayView:
    """Rays through the pixel centres of one image in row-major order, with the faces and bodies hit.

    ``face_light``: Light on the faces, if it depends on nothing else.
    """

    caster: RayCaster
    t: float
    mesh: TexturedMesh
    rays: ImageRays
    body: NDArray[np.int32]
    face_light: FaceLight | None = None

    def directions(self, pixels: NDArray[np.int64], offsets_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the directions of the samples of pixels, shape (pixels x samples, 3)."""
        across, down = (item[pixels] if len(item) > 1 else item for item in (self.rays.across, self.rays.down))
        offsets = offsets_px[:, :1] * across[:, None] + offsets_px[:, 1:] * down[:, None]
        return (self.rays.directions[pixels][:, None] + offsets).reshape(-1, 3)


class SharedSurfaces:
    """Surfaces of a scene at the times that renderers are working on, with their shadows, for all of them together."""

    def __init__(self, world: BuiltScene, topology: Topology) -> None:
        self._world, self._topology = world, topology
        self._known: WeakValueDictionary[float, ShadowCaster] = WeakValueDictionary()
        self._alone = Lock()
        self.hits = image_hits(world)

    def shadows_at(self, t: float) -> ShadowCaster:
        """Return the shadows of a time, with its vertices."""
        with self._alone:
            found = self._known.get(t)
            if found is None:
                found = self._known[t] = ShadowCaster(self._world.at(t).vertices_mm, self._topology)
            return found


class RaycastRenderer(Renderer):
    """Renderer based on ray casting, without system libraries.

    Every pixel is the mean of n x n samples by the Gauss-Legendre rule (`gauss_rule`), equally spaced at silhouettes.
    With ``adaptive``, silhouettes and pixels in which two rules differ, because a step of a texture crosses them, have
    at least (12 n)² samples (`lattice_rule`).
    """

    _confirmed = True
    """Whether shadows count only if Embree confirms them, see `ShadowCaster.blocked_parallel`."""

    def __init__(
        self,
        world: BuiltScene,
        camera: Camera,
        background: BandFraction = 0.0,
        supersampling: int = 4,
        lighting: Lighting | None = None,
        topology: Topology | None = None,
        *,
        adaptive: bool = False,
        surfaces: SharedSurfaces | None = None,
    ) -> None:
        self.name = "raycast"
        self._world = world
        self._camera = camera
        self._background = np.float32(as_number(background))
        self._topology = topology or scene_topology(world)
        self._surfaces = surfaces or SharedSurfaces(world, self._topology)
        self._caster: tuple[float, RayCaster] | None = None
        rays = pixel_rays(camera)
        self._directions = rays.directions
        # Direction steps per pixel to the right and down, per pixel if not constant.
        self._across, self._down = rays.steps
        # The Gauss rule is almost exact for smooth textures; equal spacing is best across silhouettes.
        steps, weights = gauss_rule(supersampling)
        self._reach_px = float(steps[-1])
        self._smooth = square_rule(steps, weights)
        self._mixed = square_rule(
            (np.arange(supersampling) + 0.5) / supersampling - 0.5, np.full(supersampling, 1 / supersampling)
        )
        self._fine = self._test = None
        if adaptive:
            self._fine, self._test = (
                lattice_rule((_FINER * supersampling) ** 2),
                lattice_rule(2 * supersampling**2 + 32),
            )
            self._mixed = self._fine
            # Lattices reach the border of the pixel.
            self._reach_px = 0.5
        self._lighting = lighting or Lighting()
        self._shader = Shader(self._lighting, world, confirmed=self._confirmed) if self._lighting.lit else None

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image at time t from a viewpoint, see `Renderer.render`.

        If a pixel footprint stays on one face, its samples map to the texture through the plane of the face; on one
        smooth surface, by walking across its faces. At edges every sample is traced. A body that protrudes through
        another between neighbouring pixel centres is missed.
        """
        return self._render(t, viewpoint, None)

    def light(self, albedo: Callable[[], NDArray[np.float32]], t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Apply illumination to an unlit image of the same scene and samples from another renderer.

        Only pixels at edges are rendered here. ``albedo`` is called late, because another thread may draw the image.
        """
        return self._render(t, viewpoint, albedo)

    def _render(
        self, t: float, viewpoint: Viewpoint, albedo: Callable[[], NDArray[np.float32]] | None
    ) -> NDArray[np.float32]:
        from scenetruth.raycast.hit_kernels import footprint_forms

        camera, world, caster = self._camera, self._world, self._caster_at(t)
        origin = viewpoint.position_mm
        shape = (camera.height, camera.width)
        directions, across, down = (
            viewpoint.directions_to_world(item) for item in (self._directions, self._across, self._down)
        )
        hits = caster.cast(origin, directions, grid_width=camera.width)
        body = np.where(hits.face >= 0, world.face_body[hits.face], -1).astype(np.int32)
        edges = mixed_pixels(caster, viewpoint, camera, body.reshape(shape))
        if self._surfaces.hits.expects(t, camera, viewpoint):
            self._surfaces.hits.keep(t, camera, viewpoint, FirstFaces(hits.face, edges.copy()))
        light = None if self._shader is None else self._shader.on_pixels(caster, t, origin, directions, hits, edges)
        edges = edges.ravel()
        mesh = TexturedMesh(
            caster.vertices_mm,
            world.faces,
            caster.topology.face_neighbours,
            world.face_body,
            visible_uv(world, caster, origin),
        )
        rays = ImageRays(origin, directions, across, down, hits.face, camera.width)
        view = RayView(caster, t, mesh, rays, body)
        mixed, leaving = edges, np.zeros_like(edges)
        image = np.full(len(body), self._background, dtype=np.float32) if albedo is None else albedo().ravel().copy()
        offsets, weights = self._smooth
        for index, item in enumerate(world.bodies if albedo is None else ()):
            inner = np.flatnonzero((body == index) & ~edges)
            for first in range(0, len(inner), _PIXELS_PER_PIECE):
                pixels = inner[first : first + _PIXELS_PER_PIECE]
                forms, whole = footprint_forms(mesh, rays, pixels, self._reach_px)
                if np.count_nonzero(whole) < len(pixels) / 2:
                    image[pixels[whole]] = item.texture.mean_radiance(forms[whole], offsets, weights)
                else:
                    # The remaining pixels are rendered below.
                    image[pixels] = item.texture.mean_radiance(forms, offsets, weights)
                if self._fine is not None and self._test is not None:
                    differs = np.abs(image[pixels] - item.texture.mean_radiance(forms, *self._test)) > _STEP
                    stepped = differs & whole
                    image[pixels[stepped]] = item.texture.mean_radiance(forms[stepped], *self._fine)
                leaving[pixels[~whole]] = True
        if light is not None:
            variance = float(weights @ offsets[:, 0] ** 2)
            image = light.on(image.reshape(shape), (mixed | leaving).reshape(shape), variance).ravel()
            # Equal spacing is best across shadow borders, as across silhouettes.
            mixed = mixed | light.borders.ravel()
            leaving = (leaving | light.uneven.ravel()) & ~mixed
        crossing = np.flatnonzero(leaving)
        self._sample(view, image, crossing, edges, self._smooth)
        if self._fine is not None and self._test is not None:
            smooth = image[crossing]
            self._sample(view, image, crossing, edges, self._test)
            differs = np.abs(image[crossing] - smooth) > _STEP
            image[crossing] = smooth
            self._sample(view, image, crossing[differs], edges, self._fine)
        self._sample(view, image, np.flatnonzero(mixed), edges, self._mixed)
        return image.reshape(shape) * np.float32(self._lighting.brightness(t))

    def _sample(
        self,
        view: RayView,
        image: NDArray[np.float32],
        pixels: NDArray[np.int64],
        edges: NDArray[np.bool_],
        rule: Rule,
    ) -> None:
        """Render pixels by samples: by walks across faces where possible, else by tracing."""
        at_once = max(1, _RAYS_PER_PIECE // len(rule[1]))
        given_up = edges[pixels] | (view.body[pixels] < 0)
        smooth = pixels[~given_up]
        for first in range(0, len(smooth), at_once):
            piece = smooth[first : first + at_once]
            arrived, image[piece] = self._walk(view, piece, *rule)
            given_up[np.searchsorted(pixels, piece[~arrived])] = True
        remaining = pixels[given_up]
        for first in range(0, len(remaining), at_once):
            piece = remaining[first : first + at_once]
            image[piece] = self._trace(view, piece, *rule)

    def _walk(
        self, view: RayView, pixels: NDArray[np.int64], offsets: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Return which walks reached all samples, and the means over footprints, without tracing the samples."""
        from scenetruth.raycast.hit_kernels import walk_footprints

        world = self._world
        arrived, face, depth, barycentric, uv = walk_footprints(view.mesh, view.rays, pixels, offsets)
        radiance = np.zeros(face.shape, dtype=np.float32)
        body = np.where(arrived, view.body[pixels], -1)
        for index, item in enumerate(world.bodies):
            chosen = np.flatnonzero(body == index)
            if len(chosen):
                found = item.texture.radiance(uv[chosen].reshape(-1, 2))
                radiance[chosen] = found.reshape(len(chosen), len(weights))
        if self._shader is not None:
            here = np.flatnonzero(arrived)
            hits = Hits(face[here].ravel(), depth[here].ravel(), barycentric[here].reshape(-1, 2))
            directions = view.directions(pixels[here], offsets)
            owner = np.repeat(pixels[here], len(weights))
            light = self._shader.arrived(view.caster, view.t, view.rays.origin, directions, hits, owner)
            radiance[here] = light.on(radiance[here].ravel()).reshape(len(here), len(weights))
        return arrived, np.einsum("ps,s->p", radiance, weights)

    def _trace(
        self, view: RayView, pixels: NDArray[np.int64], offsets: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the means over footprints by tracing every sample."""
        radiance = self._traced(view, view.directions(pixels, offsets), np.repeat(pixels, len(weights)))
        means: NDArray[np.float64] = np.einsum("ps,s->p", radiance.reshape(-1, len(weights)), weights)
        return means

    def _traced(self, view: RayView, directions: NDArray[np.float64], pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return the radiance along directions in pixels by tracing."""
        hits = view.caster.cast(view.rays.origin, directions)
        body = np.where(hits.face >= 0, self._world.face_body[hits.face], -1)
        uv = hits.interpolate_corners(view.mesh.uv)
        radiance = np.full(len(directions), self._background, dtype=np.float32)
        for index, item in enumerate(self._world.bodies):
            chosen = body == index
            if chosen.any():
                radiance[chosen] = item.texture.radiance(uv[chosen])
        if self._shader is not None:
            rays = (view.rays.origin, directions)
            return self._shader.on_hits(radiance, view.caster, view.t, *rays, hits, view.face_light, pixels)
        return radiance

    def _caster_at(self, t: float) -> RayCaster:
        if self._caster is None or self._caster[0] != t:
            shadows = self._surfaces.shadows_at(t)
            self._caster = (t, RayCaster(shadows.vertices_mm, self._topology))
            if self._shader is not None:
                self._shader.use_shadows(shadows)
        return self._caster[1]

    def repeating_caster_at(self, t: float) -> RepeatingRayCaster:
        """Return the ray caster of a time, which keeps its results, and use it from now on."""
        if self._caster is None or self._caster[0] != t or not isinstance(self._caster[1], RepeatingRayCaster):
            found = RepeatingRayCaster(self._world.at(t).vertices_mm, self._topology)
            self._caster = (t, found)
            return found
        return self._caster[1]

    def use_caster(self, t: float, caster: RayCaster) -> None:
        """Use the ray caster of another renderer of the same geometry at time t."""
        self._caster = (t, caster)

    def close(self) -> None:
        """Release the mesh, the only resource."""
        self._caster = None


class RepeatingRayCaster(RayCaster):
    """Ray caster that keeps its results for the bands of an image, which cast the same rays."""

    def __init__(self, vertices_mm: NDArray[np.float64], topology: Topology) -> None:
        super().__init__(vertices_mm, topology)
        self._known: list[tuple[str, tuple[Any, ...], Any]] = []
        self._kept_bytes = 0

    def again(self, name: str, compute: Callable[[], Any], *given: Any) -> Any:
        """Return the result for arguments, computed at the first call; results must not be modified."""
        for known, arguments, result in self._known:
            if known == name and len(arguments) == len(given) and all(map(_equal, arguments, given)):
                return result
        result = compute()
        size = 2 * sum(getattr(argument, "nbytes", 0) for argument in given)
        if self._kept_bytes + size <= _MOST_KEPT_BYTES:
            self._known.append((name, given, result))
            self._kept_bytes += size
        return result

    def forget(self) -> None:
        """Free the results."""
        self._known.clear()
        self._kept_bytes = 0

    @cached_property
    def shadows(self) -> ShadowCaster:
        """Shadows of the mesh on itself for all bands, kept as well."""
        return _RepeatingShadows(self)

    def cast(self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], grid_width: int = 0) -> Hits:
        """Compute the first hits, see `RayCaster.cast`."""
        hits: Hits = self.again(
            "cast", lambda: super(RepeatingRayCaster, self).cast(origin_mm, directions, grid_width),
            origin_mm, directions, grid_width,
        )  # fmt: skip
        return hits

    def cast_in_pixels(
        self, origin_mm: NDArray[np.float64], directions: NDArray[np.float64], pixels: NDArray[np.int64]
    ) -> Hits:
        """Compute the first hits, see `RayCaster.cast_in_pixels`."""
        hits: Hits = self.again(
            "cast in pixels", lambda: super(RepeatingRayCaster, self).cast_in_pixels(origin_mm, directions, pixels),
            origin_mm, directions, pixels,
        )  # fmt: skip
        return hits


class _RepeatingShadows(ShadowCaster):
    """Shadows that are kept for the bands of an image."""

    def __init__(self, caster: RepeatingRayCaster) -> None:
        super().__init__(caster.vertices_mm, caster.topology)
        self._again = caster.again

    def blocked_parallel(
        self,
        points_mm: NDArray[np.float64],
        faces: NDArray[np.int32],
        wanted: NDArray[np.bool_],
        to_light: NDArray[np.float64],
        *,
        confirmed: bool = True,
    ) -> NDArray[np.bool_]:
        """Return which wanted points light does not reach, see `ShadowCaster.blocked_parallel`."""

        def find() -> NDArray[np.bool_]:
            return super(_RepeatingShadows, self).blocked_parallel(
                points_mm, faces, wanted, to_light, confirmed=confirmed
            )

        dark: NDArray[np.bool_] = self._again("parallel", find, points_mm, faces, wanted, to_light, confirmed)
        return dark


def _equal(one: Any, other: Any) -> bool:
    return one is other or bool(np.array_equal(one, other))


class BandRenderer(Renderer):
    """Renderer of several bands, one after the other, with the same geometry.

    Hits, silhouettes and shadows are computed for the first band and used for all.
    """

    def __init__(self, renderers: Sequence[RaycastRenderer]) -> None:
        self._renderers = tuple(renderers)
        self.name = renderers[0].name

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image of all bands, shape (y, x, band), see `Renderer.render`."""
        caster = self._renderers[0].repeating_caster_at(t)
        for other in self._renderers[1:]:
            other.use_caster(t, caster)
        image = np.stack([renderer.render(t, viewpoint) for renderer in self._renderers], axis=-1)
        caster.forget()
        return image

    def close(self) -> None:
        """Close the renderers of all bands."""
        for renderer in self._renderers:
            renderer.close()
