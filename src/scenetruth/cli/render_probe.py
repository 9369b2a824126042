"""Script that renders a small triangle; `diagnostics` runs it in a separate process, which system libraries may abort.

Nothing of scenetruth is imported.
"""

from __future__ import annotations

import os
import sys

ANSWER = "scenetruth: it renders"
"""Prefix of the output on success, followed by the renderer."""

_CORNERS = [[-1.0, -1.0, -2.0], [1.0, -1.0, -2.0], [0.0, 1.0, -2.0]]
"""A triangle in front of a camera that faces -Z."""
_SIZE_PX = 8


def _by_opengl(platform: str) -> str:
    os.environ["PYOPENGL_PLATFORM"] = platform
    import numpy as np
    import pyrender
    import trimesh
    from OpenGL import GL

    body = trimesh.Trimesh(np.array(_CORNERS), [[0, 1, 2]], process=False)
    scene = pyrender.Scene()
    scene.add(pyrender.Mesh.from_trimesh(body, smooth=False))
    scene.add(pyrender.PerspectiveCamera(1.0))
    renderer = pyrender.OffscreenRenderer(_SIZE_PX, _SIZE_PX)
    try:
        depth = renderer.render(scene, flags=pyrender.RenderFlags.DEPTH_ONLY)
        version = GL.glGetString(GL.GL_VERSION).decode(errors="replace")
    finally:
        renderer.delete()
    middle, corner = depth[_SIZE_PX // 2, _SIZE_PX // 2], depth[0, 0]
    if not abs(middle - 2) < 1e-3 or corner != 0:
        sys.exit(f"the triangle at a depth of 2 is rendered at {middle:g}, and the background at {corner:g}")
    return f"OpenGL {version}"


def _by_rays() -> str:
    from importlib.metadata import version

    import numpy as np
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene(robust=True)
    # Keeps the object alive.
    mesh = TriangleMesh(scene, np.array(_CORNERS, dtype=np.float32), np.array([[0, 1, 2]], dtype=np.int32))
    rays = np.array([[0, 0, -1], [0, 0, 1]], dtype=np.float32)
    met = scene.run(np.zeros((2, 3), dtype=np.float32), rays).tolist()
    del mesh
    if met != [0, -1]:
        sys.exit(f"rays towards the triangle and away from it hit faces {met}, and not 0 and -1")
    return f"embreex {version('embreex')}"


if __name__ == "__main__":
    wanted = sys.argv[1]
    print(ANSWER, _by_rays() if wanted == "raycast" else _by_opengl(wanted))
