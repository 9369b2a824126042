"""Plane sweep: disparity by semi-global matching of all cameras, and scene flow by random search."""
