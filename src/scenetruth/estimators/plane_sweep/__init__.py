"""Plane sweep: disparity of every pixel by semi-global matching of all cameras; scene flow by random search."""
