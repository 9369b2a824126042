"""Growth of surfaces, from depth and velocity: the map, and its score."""

from scenetruth.scoring.growth.rate import growth_maps, growth_pairs, knows_growth, surface_growth

__all__ = ["growth_maps", "growth_pairs", "knows_growth", "surface_growth"]
