"""Cameras that are not where they should be: how far each image is off, found from all points together."""
