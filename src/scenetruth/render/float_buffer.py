"""Float32 textures and framebuffers in OpenGL, where pyrender has 8 bits."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import BackendUnavailableError

__all__ = ["FloatBuffer", "float_material", "largest_side"]

_SHADERS = Path(__file__).parent / "shaders"
_MARGIN = ((1, 2), (1, 2))  # as the shader expects it


class FloatBuffer:
    """Framebuffer with one float32 channel that replaces the framebuffer and shader of a pyrender renderer.

    It caches compiled programs and needs exclusive use of ``renderer``. The OpenGL context must be current.
    """

    def __init__(self, renderer: Any, size: tuple[int, int]) -> None:
        from OpenGL import GL

        self._gl = GL
        self._programs: dict[tuple[str, ...], Any] = {}
        self._size = size
        self._samples = np.empty(0, dtype=np.float32)
        self._colour, self._depth = GL.glGenRenderbuffers(2)
        self._buffer = GL.glGenFramebuffers(1)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._buffer)
        for target, place, form in (
            (self._colour, GL.GL_COLOR_ATTACHMENT0, GL.GL_R32F),
            (self._depth, GL.GL_DEPTH_ATTACHMENT, GL.GL_DEPTH_COMPONENT32F),
        ):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, target)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, form, *size)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, place, GL.GL_RENDERBUFFER, target)
        state = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        if state != GL.GL_FRAMEBUFFER_COMPLETE:
            raise BackendUnavailableError(
                "pyrender",
                f"OpenGL does not support a {size[0]} x {size[1]} float32 framebuffer (state {int(state):#x})",
                "use the raycast backend or another platform",
            )
        self._renderer = renderer
        renderer.viewport_width, renderer.viewport_height = size
        renderer._configure_forward_pass_viewport = self._bind
        renderer._read_main_framebuffer = self._read
        renderer._get_primitive_program = self._program

    def draw(self, scene: Any, nodes: Sequence[Any], samples: NDArray[np.float32]) -> None:
        """Draw a scene into samples of shape (height, width), rows from the bottom up."""
        from pyrender import RenderFlags

        self._samples = samples
        self._renderer._sorted_mesh_nodes = lambda _scene: nodes
        self._renderer.render(scene, RenderFlags.FLAT | RenderFlags.OFFSCREEN)

    def _bind(self, _flags: int) -> None:
        gl = self._gl
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._buffer)
        gl.glViewport(0, 0, *self._size)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glDepthMask(gl.GL_TRUE)
        gl.glDepthFunc(gl.GL_LESS)
        gl.glDepthRange(0.0, 1.0)

    def _read(self, _scene: Any, _flags: int) -> None:
        gl = self._gl
        gl.glReadBuffer(gl.GL_COLOR_ATTACHMENT0)
        gl.glReadPixels(0, 0, *self._size, gl.GL_RED, gl.GL_FLOAT, self._samples)

    def _program(self, primitive: Any, _flags: int, _program_flags: int) -> Any:
        return self._programs[primitive.material.texture_defines]

    def prepare(self, material: Any) -> None:
        """Compile the program of a material unless cached."""
        from pyrender.shader_program import ShaderProgram

        defines = material.texture_defines
        if defines in self._programs:
            return
        files = (str(_SHADERS / f"texture.{kind}") for kind in ("vert", "frag"))
        program = ShaderProgram(*files, defines=dict.fromkeys(defines, 1))
        try:
            program._add_to_context()
        except RuntimeError as error:  # raised by PyOpenGL for compilation and linking errors
            reason = str(error.args[0]).splitlines()[0]
            raise BackendUnavailableError(
                "pyrender",
                f"OpenGL does not compile the shader: {reason}",
                "use the raycast backend or another platform",
            ) from error
        self._programs[defines] = program

    def delete(self) -> None:
        """Free the buffers and programs; the OpenGL context must be current."""
        gl = self._gl
        for program in self._programs.values():
            program.delete()
        gl.glDeleteFramebuffers(1, [self._buffer])
        gl.glDeleteRenderbuffers(2, [self._colour, self._depth])


def largest_side() -> int:
    """Return the maximum width or height of a buffer; the OpenGL context must be current."""
    from OpenGL import GL

    return int(min(GL.glGetIntegerv(GL.GL_MAX_RENDERBUFFER_SIZE), *GL.glGetIntegerv(GL.GL_MAX_VIEWPORT_DIMS)))


def float_material(values: NDArray[np.float32], *, tiled: bool, cubic: bool, two_sided: bool = False) -> Any:
    """Return a material for texture coordinates in texels, with values or B-spline coefficients of shape (h, w)."""
    import pyrender
    from OpenGL import GL

    limit = int(GL.glGetIntegerv(GL.GL_MAX_TEXTURE_SIZE))
    padded = np.pad(values, _MARGIN, mode="wrap" if tiled else "edge")
    if max(padded.shape) > limit:
        raise BackendUnavailableError(
            "pyrender",
            f"OpenGL supports textures of up to {limit - 3} x {limit - 3} texels, this texture has "
            f"{values.shape[1]} x {values.shape[0]}",
            "use the raycast backend or a smaller image",
        )
    height, width = padded.shape
    texture = pyrender.Texture(source_channels="R", width=width, height=height, data_format=GL.GL_FLOAT)
    # A texture that held its own function would be freed by the garbage collector only.
    own: Any = weakref.proxy(texture)

    def upload() -> None:
        own._texid = GL.glGenTextures(1)
        GL.glBindTexture(GL.GL_TEXTURE_2D, own._texid)
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 4)
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_R32F, width, height, 0, GL.GL_RED, GL.GL_FLOAT, padded)
        # Without mip-maps a texture is complete only if no filter uses them.
        for which in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, which, GL.GL_NEAREST)
        GL.glBindTexture(GL.GL_TEXTURE_2D, 0)

    texture._add_to_context = upload
    material = pyrender.MetallicRoughnessMaterial(
        baseColorFactor=[1.0, 1.0, 1.0, 1.0], baseColorTexture=texture, doubleSided=True
    )
    material.texture_defines = tuple(
        name for name, wanted in (("TILED", tiled), ("CUBIC", cubic), ("TWO_SIDED", two_sided)) if wanted
    )
    return material
