"""Ray casting against triangle meshes with exact hits in float64."""

from scenetruth.raycast.edges import (
    Changes,
    MixedPixels,
    SurfaceLines,
    find_mixed_pixels,
    mixed_pixels,
    places_in_pixels,
)
from scenetruth.raycast.image_hits import FirstFaces, ImageHits, image_hits
from scenetruth.raycast.mesh_topology import ImageRays, TexturedMesh, Topology, scene_topology
from scenetruth.raycast.ray_caster import Hits, RayCaster
from scenetruth.raycast.shadows import ShadowCaster

__all__ = [
    "Changes",
    "FirstFaces",
    "Hits",
    "ImageHits",
    "ImageRays",
    "MixedPixels",
    "RayCaster",
    "ShadowCaster",
    "SurfaceLines",
    "TexturedMesh",
    "Topology",
    "find_mixed_pixels",
    "image_hits",
    "mixed_pixels",
    "places_in_pixels",
    "scene_topology",
]
