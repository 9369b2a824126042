"""The 4D structure tensor over x, y, s and t, which gives disparity and scene flow (the method of the paper)."""
