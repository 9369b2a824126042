"""Fits anew where whole windows over all frames do not hold: beside outlines, and where motion is not steady."""
