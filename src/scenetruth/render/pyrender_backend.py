"""The OpenGL backend: pyrender on OSMesa or EGL, supersampled; light is put on by the ray caster."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint
from scenetruth.render.opengl import use_platform
from scenetruth.render.protocol import Renderer
from scenetruth.render.raycast_backend import RaycastRenderer
from scenetruth.scene.spec import Lighting
from scenetruth.scene.world import World

__all__ = ["PyrenderRenderer"]

# pyrender looks along -Z with Y up; our camera looks along +Z with Y down.
_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
# Clipping planes this much nearer and farther than the surfaces, so that rounding cuts nothing away.
_SLACK = 0.01


class PyrenderRenderer(Renderer):
    """Renders with OpenGL.

    Every pixel is the mean, taken in floating point, of n x n samples with the texture interpolated bilinearly from its
    full resolution: no mip-maps, no lights, no tone curve.

    Parameters
    ----------
    world
        What to see.
    camera
        With which camera.
    background
        Radiance in [0, 1] where no surface is met.
    supersampling
        n.
    platform
        ``"osmesa"``, ``"egl"`` or ``"auto"``.
    lighting
        The light on it; none for textures that shine by themselves. OpenGL gives the unlit image, which is multiplied
        by the light that ray casting finds for each pixel; pixels at edges, of objects or of light, are ray cast.

    Raises
    ------
    BackendUnavailableError
        If OpenGL does not run here.
    """

    def __init__(
        self,
        world: World,
        camera: Camera,
        background: float = 0.0,
        supersampling: int = 4,
        platform: str = "auto",
        lighting: Lighting | None = None,
    ) -> None:
        self._platform = use_platform(platform)
        import pyrender

        self.name = f"pyrender ({self._platform})"
        self._pyrender = pyrender
        self._world = world
        self._size = (camera.width, camera.height)
        self._n = supersampling
        self._materials = [_material(pyrender, body.texture) for body in world.bodies]
        self._lighting = lighting or Lighting()
        self._lit: RaycastRenderer | None = None
        if self._lighting.lit:
            self._lit = RaycastRenderer(world, camera, background, supersampling, self._lighting)
        self._t: float | None = None
        self._vertices_mm = np.empty((0, 3))
        self._nodes: list[Any] = []
        self._scene = pyrender.Scene(bg_color=[background] * 3 + [1.0], ambient_light=[0.0, 0.0, 0.0])
        c_x, c_y = camera.principal_point
        focal = camera.focal_px * supersampling
        # pyrender's principal point counts from the image's corner, half a pixel before our first pixel centre.
        self._centre = ((c_x + 0.5) * supersampling, (c_y + 0.5) * supersampling)
        self._camera = pyrender.IntrinsicsCamera(focal, focal, *self._centre)
        self._camera_node = self._scene.add(self._camera, pose=_TURN)
        self._renderer: Any = pyrender.OffscreenRenderer(camera.width * supersampling, camera.height * supersampling)
        _keep_programs(self._renderer._renderer._program_cache)
        from OpenGL.GL import GL_UNPACK_ALIGNMENT, glPixelStorei

        # Rows of one byte a texel need not end at multiples of four; OpenGL assumes it and would shear the texture.
        glPixelStorei(GL_UNPACK_ALIGNMENT, 1)

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the image at time t from a viewpoint; see `Renderer.render`."""
        unlit = self._render_unlit(t, viewpoint)
        if self._lit is not None:
            return self._lit.light(unlit, t, viewpoint)
        return unlit * np.float32(self._lighting.brightness(t))

    def _render_unlit(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        if self._t != t:
            self._place_world(t)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = viewpoint.rotation, viewpoint.position_mm
        self._scene.set_pose(self._camera_node, pose @ _TURN)
        self._camera.cx = self._centre[0] - viewpoint.shear[0] * self._camera.fx
        self._camera.cy = self._centre[1] - viewpoint.shear[1] * self._camera.fy
        self._clip(viewpoint.to_camera(self._vertices_mm)[:, 2])
        colour, _ = self._renderer.render(self._scene, flags=self._pyrender.RenderFlags.FLAT)
        (width, height), n = self._size, self._n
        samples = colour[..., 0].reshape(height, n, width, n)
        # Sums of 8-bit samples are exact in integers, and much faster than a mean over strided axes.
        sums = samples.sum(axis=3, dtype=np.uint16).sum(axis=1, dtype=np.uint32)
        return np.asarray(sums / (255.0 * n * n), dtype=np.float32)

    def _place_world(self, t: float) -> None:
        pyrender = self._pyrender
        for node in self._nodes:
            self._scene.remove_node(node)
        self._nodes = []
        vertices = self._world.at(t).vertices_mm
        offsets = self._world.vertex_offsets
        for index, (body, material) in enumerate(zip(self._world.bodies, self._materials, strict=True)):
            corners = vertices[offsets[index] : offsets[index + 1]][body.faces]
            # Texture coordinates belong to corners, so that every face has vertices of its own.
            uv = body.uv.reshape(-1, 2) * (1, -1) + (0, 1)
            primitive = pyrender.Primitive(
                positions=corners.reshape(-1, 3).astype(np.float32),
                texcoord_0=uv.astype(np.float32),
                material=material,
                mode=pyrender.GLTF.TRIANGLES,
            )
            self._nodes.append(self._scene.add(pyrender.Mesh(primitives=[primitive])))
        self._vertices_mm, self._t = vertices, t

    def _clip(self, depth: NDArray[np.float64]) -> None:
        """Put the clipping planes round vertices of these depths."""
        nearest = depth[depth > 0].min(initial=np.inf)
        self._camera.znear = float(max(nearest * (1 - _SLACK), 1e-3 * depth.max()))
        self._camera.zfar = float(depth.max() * (1 + _SLACK))

    def close(self) -> None:
        """Free the OpenGL context and everything in it; closing twice is harmless."""
        if self._renderer is not None:
            self._renderer.delete()
            self._renderer = None


def _material(pyrender: Any, texture: Any) -> Any:
    raster = np.rint(np.clip(texture.raster(), 0, 1) * 255).astype(np.uint8)
    wrap = pyrender.GLTF.REPEAT if texture.tiled else pyrender.GLTF.CLAMP_TO_EDGE
    sampler = pyrender.Sampler(magFilter=pyrender.GLTF.LINEAR, minFilter=pyrender.GLTF.LINEAR, wrapS=wrap, wrapT=wrap)
    image = pyrender.Texture(sampler=sampler, source=raster[..., None], source_channels="R")
    return pyrender.MetallicRoughnessMaterial(
        baseColorFactor=[1.0, 1.0, 1.0, 1.0], baseColorTexture=image, doubleSided=True
    )


def _keep_programs(cache: Any) -> None:
    """Make pyrender find the shader programs that it has compiled.

    It looks them up by a handle of the OpenGL context that PyOpenGL makes anew at every call on OSMesa, so that every
    render compiles its programs again and keeps them all. This renderer has one context only.
    """
    compile_program, programs = cache.get_program, {}

    def get_program(
        vertex_shader: str, fragment_shader: str, geometry_shader: str | None = None, defines: Any = None
    ) -> Any:
        key = (vertex_shader, fragment_shader, geometry_shader, tuple(sorted((defines or {}).items())))
        if key not in programs:
            programs[key] = compile_program(vertex_shader, fragment_shader, geometry_shader, defines)
        return programs[key]

    cache.get_program = get_program
