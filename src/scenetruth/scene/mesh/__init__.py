"""Triangle meshes, generated or read from files."""

from scenetruth.scene.mesh.mesh_model import MeshModel, MeshSize, TriangleMesh

__all__ = ["MeshModel", "MeshSize", "TriangleMesh"]
