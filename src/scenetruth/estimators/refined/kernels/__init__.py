"""Kernels of the refined estimator."""
