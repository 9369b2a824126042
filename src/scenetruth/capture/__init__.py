"""Real captures: calibration of a camera on its stage, ingest of images and their noise."""
