"""4D structure tensor over x, y, s and t for disparity and scene flow: the method of the paper."""
