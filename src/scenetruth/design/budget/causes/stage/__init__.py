"""Causes in where and when images are taken: the stage, the scan, the shutter."""
