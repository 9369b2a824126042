"""Exact geometry: which triangle a ray meets first, and the point on it in float64."""

from scenetruth.raycast.caster import Hits, RayCaster
from scenetruth.raycast.edges import mixed_pixels
from scenetruth.raycast.footprints import ImageRays, TexturedMesh
from scenetruth.raycast.shadows import ShadowCaster
from scenetruth.raycast.topology import Topology

__all__ = ["Hits", "ImageRays", "RayCaster", "ShadowCaster", "TexturedMesh", "Topology", "mixed_pixels"]
