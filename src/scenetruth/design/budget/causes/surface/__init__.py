"""Causes in the surface, and in the method itself: what is left with ideal images."""
