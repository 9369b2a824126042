"""Causes in images: the sensor, the lens, the light."""
