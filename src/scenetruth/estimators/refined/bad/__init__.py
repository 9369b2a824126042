"""Pixels and images that must not be used, found before and while surfaces are fitted."""
