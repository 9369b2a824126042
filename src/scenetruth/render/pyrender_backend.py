"""OpenGL backend: pyrender on OSMesa or EGL, supersampled in float32, with illumination by ray casting."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import BandFraction, as_number
from scenetruth.camera import Camera, Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.render.opengl import REMEDIES, use_platform
from scenetruth.render.raycast_backend import RaycastRenderer, even_rule
from scenetruth.render.renderer import Renderer
from scenetruth.scene.built_scene import BuiltScene
from scenetruth.scene.lighting import Lighting

__all__ = ["PyrenderRenderer"]

# pyrender cameras look along -Z with Y up; scenetruth cameras along +Z with Y down.
_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
_SLACK = 0.01  # relative margin of the clipping planes, so that rounding does not clip surfaces
_SAMPLES_PER_TILE = 1 << 23  # larger images are drawn in tiles to limit memory, at 8 bytes per sample including depth


class PyrenderRenderer(Renderer):
    """Renderer based on OpenGL.

    Every pixel is a weighted mean of n x n samples (`even_rule`) of the texture spline (noise, plaid) or its bilinear
    interpolation (images), without mip-maps, lights or tone mapping, in float32. With lights, this unlit image is
    multiplied by the irradiance from ray casting; pixels at object or shadow edges are ray cast.
    """

    def __init__(
        self,
        world: BuiltScene,
        camera: Camera,
        background: BandFraction = 0.0,
        supersampling: int = 4,
        platform: str = "auto",
        lighting: Lighting | None = None,
    ) -> None:
        self._platform = use_platform(platform)
        self.name = f"pyrender ({self._platform})"
        self._world = world
        self._size = (camera.width, camera.height)
        self._n = supersampling
        self._weights = even_rule(supersampling)[1]
        self._lighting = lighting or Lighting()
        self._lit: RaycastRenderer | None = None
        if self._lighting.lit:
            self._lit = RaycastRenderer(world, camera, background, supersampling, self._lighting)
        self._moved: tuple[float, NDArray[np.float64]] | None = None
        # OpenGL runs in a separate thread, the only one that uses the context.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="opengl")
        self._drawing: _Drawing | None = None
        try:
            self._drawing = self._thread.submit(_Drawing, world, camera, as_number(background), supersampling).result()
        except BackendUnavailableError:
            self._thread.shutdown()
            raise
        except (ImportError, AttributeError, RuntimeError, OSError) as error:
            # The platform works but its Python packages do not, for example due to incompatible versions.
            self._thread.shutdown()
            reason = f"{type(error).__name__}: {error}"
            remedy = f"{REMEDIES[self._platform]} and reinstall scenetruth[opengl], or use the raycast backend"
            raise BackendUnavailableError(self.name, reason, remedy) from error

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image at time t from a viewpoint, see `Renderer.render`."""
        return self._finish(t, viewpoint, self._begin(t, viewpoint))

    def render_all(self, moments: Iterable[tuple[float, Viewpoint]]) -> Iterator[NDArray[np.float32]]:
        """Render consecutive images, drawing each while the previous one is processed, see `Renderer`."""
        waiting: tuple[float, Viewpoint, Iterator[_Part]] | None = None
        for t, viewpoint in moments:
            parts = self._begin(t, viewpoint)
            if waiting is not None:
                yield self._finish(*waiting)
            waiting = (t, viewpoint, parts)
        if waiting is not None:
            yield self._finish(*waiting)

    def _begin(self, t: float, viewpoint: Viewpoint) -> Iterator[_Part]:
        """Start drawing the first tile of an image and return an iterator over all tiles."""
        assert self._drawing is not None
        if self._moved is None or self._moved[0] != t:
            self._moved = (t, self._world.at(t).vertices_mm)
        vertices = self._moved[1]
        (width, height), (across, down) = self._size, self._drawing.tile
        places = [(x, y) for y in range(0, height, down) for x in range(0, width, across)]

        def draw(place: tuple[int, int]) -> Future[NDArray[np.float32]]:
            assert self._drawing is not None
            return self._thread.submit(self._drawing.draw, t, vertices, viewpoint, place)

        first = draw(places[0])

        def parts() -> Iterator[_Part]:
            samples = first
            for number, place in enumerate(places):
                yield place, samples.result()
                if number + 1 < len(places):
                    samples = draw(places[number + 1])

        return parts()

    def _finish(self, t: float, viewpoint: Viewpoint, parts: Iterator[_Part]) -> NDArray[np.float32]:
        def unlit() -> NDArray[np.float32]:
            return self._average(parts)

        if self._lit is not None:
            return self._lit.light(unlit, t, viewpoint)
        return unlit() * np.float32(self._lighting.brightness(t))

    def _average(self, parts: Iterator[_Part]) -> NDArray[np.float32]:
        from scenetruth.render.downsampling_kernels import average_samples

        assert self._drawing is not None
        (width, height), (across, down), n = self._size, self._drawing.tile, self._n
        image = np.empty((height, width), dtype=np.float32)
        for (x, y), samples in parts:
            part = image[y : y + down, x : x + across]
            # The last tiles may extend beyond the image; rows run from the bottom up.
            average_samples(samples[(down - len(part)) * n :], self._weights, part)
            self._drawing.take_back(samples)
        return image

    def close(self) -> None:
        """Free the OpenGL context and its resources; repeated calls have no effect."""
        if self._drawing is not None:
            self._thread.submit(self._drawing.close).result()
            self._thread.shutdown()
            self._drawing = None


_Part = tuple[tuple[int, int], NDArray[np.float32]]
"""Upper-left pixel of a tile, and its samples."""


class _Drawing:
    """OpenGL context with the objects of a scene, used only by the thread that creates it."""

    def __init__(self, world: BuiltScene, camera: Camera, background: float, supersampling: int) -> None:
        import pyrender

        from scenetruth.render.float_buffer import FloatBuffer, float_material, largest_side

        self._pyrender = pyrender
        self._world = world
        self._n = supersampling
        self._t: float | None = None
        self._nodes: list[Any] = []
        self._free: list[NDArray[np.float32]] = []
        # Images are drawn to a separate framebuffer, so that of the context may be small.
        self._context: Any = pyrender.OffscreenRenderer(16, 16)
        self._scene = pyrender.Scene(bg_color=[background] * 3 + [1.0], ambient_light=[0.0, 0.0, 0.0])
        focal = camera.focal_px * supersampling
        self._principal_point = camera.principal_point
        self._camera = pyrender.IntrinsicsCamera(focal, focal, 0.0, 0.0)
        self._camera_node = self._scene.add(self._camera, pose=_TURN)
        self._materials: list[Any] = []
        self._texels: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []
        self._texels_back: list[NDArray[np.float32] | None] = []
        try:
            for body in world.bodies:
                raster = body.texture.raster()
                tiled, two_sided = body.texture.tiled, body.uv_back is not None
                self._materials.append(
                    float_material(raster, tiled=tiled, cubic=body.texture.cubic, two_sided=two_sided)
                )
                self._texels.append(_texels(body.uv, raster.shape, tiled=tiled))
                if body.uv_back is None:
                    self._texels_back.append(None)
                else:
                    self._texels_back.append(np.hstack(_texels(body.uv_back, raster.shape, tiled=tiled)))
            self.tile = _tile_size(camera.width, camera.height, supersampling, largest_side())
            self._buffer = FloatBuffer(
                self._context._renderer, (self.tile[0] * supersampling, self.tile[1] * supersampling)
            )
            for material in self._materials:
                self._buffer.prepare(material)
        except BackendUnavailableError:
            self._release()
            raise

    def draw(
        self, t: float, vertices_mm: NDArray[np.float64], viewpoint: Viewpoint, place: tuple[int, int]
    ) -> NDArray[np.float32]:
        """Return the samples of a tile, shape (height n, width n), from the bottom up, for `take_back`."""
        if self._t != t:
            self._place_world(t, vertices_mm)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = viewpoint.rotation, viewpoint.position_mm
        self._scene.set_pose(self._camera_node, pose @ _TURN)
        depth = viewpoint.to_camera(vertices_mm)[:, 2]
        self._clip(depth)
        # Front to back, because hidden fragments are not shaded.
        parts = np.split(depth, self._world.vertex_offsets[1:-1])
        nodes = [self._nodes[index] for index in np.argsort([part.mean() for part in parts], kind="stable")]
        # pyrender measures the principal point from the image corner, half a pixel before the first pixel centre.
        (x, y), n = place, self._n
        self._camera.cx = (self._principal_point[0] + 0.5 - x) * n - viewpoint.shear[0] * self._camera.fx
        self._camera.cy = (self._principal_point[1] + 0.5 - y) * n - viewpoint.shear[1] * self._camera.fy
        self._context._platform.make_current()
        samples = self._free.pop() if self._free else np.empty((self.tile[1] * n, self.tile[0] * n), dtype=np.float32)
        self._buffer.draw(self._scene, nodes, samples)
        self._context._platform.make_uncurrent()
        return samples

    def take_back(self, samples: NDArray[np.float32]) -> None:
        """Return a sample buffer for reuse."""
        self._free.append(samples)

    def _place_world(self, t: float, vertices: NDArray[np.float64]) -> None:
        pyrender = self._pyrender
        for node in self._nodes:
            self._scene.remove_node(node)
        self._nodes = []
        offsets = self._world.vertex_offsets
        for index, (coordinates, material) in enumerate(zip(self._texels, self._materials, strict=True)):
            # Texture coordinates are per corner, so vertices are not shared between faces.
            corners = vertices[offsets[index] : offsets[index + 1]][self._world.bodies[index].faces]
            primitive = pyrender.Primitive(
                positions=corners.reshape(-1, 3).astype(np.float32),
                texcoord_0=coordinates[0],
                texcoord_1=coordinates[1],
                # OpenGL determines the front of a face from the order of its corners in the image, as does scenetruth.
                tangents=self._texels_back[index],
                material=material,
                mode=pyrender.GLTF.TRIANGLES,
            )
            self._nodes.append(self._scene.add(pyrender.Mesh(primitives=[primitive])))
        self._t = t

    def _clip(self, depth: NDArray[np.float64]) -> None:
        """Set the clipping planes for a range of vertex depths."""
        nearest = depth[depth > 0].min(initial=np.inf)
        self._camera.znear = float(max(nearest * (1 - _SLACK), 1e-3 * depth.max()))
        self._camera.zfar = float(depth.max() * (1 + _SLACK))

    def close(self) -> None:
        """Free the OpenGL context and its resources."""
        self._context._platform.make_current()
        self._buffer.delete()
        self._release()

    def _release(self) -> None:
        """Do what `OffscreenRenderer.delete` does, but for a run of the garbage collector (0.1 s in large programs)."""
        context = self._context
        context._platform.make_current()
        context._renderer.delete()
        context._platform.delete_context()
        # These refer to each other: without this, their textures would wait for the collector.
        vars(context._renderer).clear()
        self._scene.clear()
        context._renderer = context._platform = None


def _tile_size(width: int, height: int, n: int, limit: int) -> tuple[int, int]:
    """Return the width and height in px of equally sized tiles of an image."""
    across = math.ceil(width / math.ceil(width * n / (limit - limit % n)))
    rows = max(1, min(limit // n, _SAMPLES_PER_TILE // (across * n * n)))
    return across, math.ceil(height / math.ceil(height / rows))


def _texels(
    uv: NDArray[np.float64], shape: tuple[int, ...], *, tiled: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return corner positions relative to an integer texel at the face centre (float32 precision), and that texel."""
    size = np.array(shape[::-1])
    texels = uv * size - 0.5
    origins = np.floor(texels.mean(axis=1, keepdims=True))
    relative = texels - origins
    if tiled:
        origins %= size
    return relative.reshape(-1, 2).astype(np.float32), np.repeat(origins[:, 0], 3, axis=0).astype(np.float32)
