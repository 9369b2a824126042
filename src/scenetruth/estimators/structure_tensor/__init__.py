"""The paper's estimator: one 4D structure tensor over x, y, s and t gives disparity and motion."""
