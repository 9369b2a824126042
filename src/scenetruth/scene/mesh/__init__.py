"""Triangle meshes, generated or read from files."""

from scenetruth.scene.mesh.mesh_file import load_mesh_file
from scenetruth.scene.mesh.mesh_model import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.sheets import PlaneMesh, make_plane, make_sheet
from scenetruth.scene.mesh.solids import make_box, make_sphere

__all__ = [
    "MeshModel",
    "MeshSize",
    "PlaneMesh",
    "TriangleMesh",
    "load_mesh_file",
    "make_box",
    "make_plane",
    "make_sheet",
    "make_sphere",
]
