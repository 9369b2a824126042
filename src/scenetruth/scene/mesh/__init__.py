"""Triangle meshes, generated or read from files."""

from scenetruth.scene.mesh.appearance import MeshAppearance
from scenetruth.scene.mesh.file_preflight import count_elements
from scenetruth.scene.mesh.mesh_file import load_mesh_file
from scenetruth.scene.mesh.mesh_model import MeshModel, MeshSize, TriangleMesh
from scenetruth.scene.mesh.polygon_mesh import MeshFileError
from scenetruth.scene.mesh.sheets import PlaneMesh, make_plane, make_relief, make_saddle, make_sheet
from scenetruth.scene.mesh.solids import (
    make_box,
    make_cylinder,
    make_sphere,
    make_spherical_cap,
    make_stairs,
    make_torus,
)
from scenetruth.scene.mesh.topology_repair import repair_topology

__all__ = [
    "MeshAppearance", "MeshFileError", "MeshModel", "MeshSize", "PlaneMesh", "TriangleMesh", "count_elements",
    "load_mesh_file", "make_box", "make_cylinder", "make_plane", "make_relief", "make_saddle", "make_sheet",
    "make_sphere", "make_spherical_cap", "make_stairs", "make_torus", "repair_topology",
]  # fmt: skip
