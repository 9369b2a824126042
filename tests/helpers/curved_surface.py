"""A curved surface for fits."""

from __future__ import annotations

import numpy as np
import xarray as xr

from scenetruth.schema import make_recording

__all__ = ["curved"]


def curved(bend: float, noise_std: float) -> tuple[xr.Dataset, np.ndarray]:
    """Return one frame of a surface whose disparity is 8 + bend x² / 2, and that disparity."""
    height, width = 72, 120
    y, x = np.mgrid[:height, :width].astype(float)
    middle = (width - 1) / 2
    generator = np.random.default_rng(4)
    waves = generator.uniform(-1.1, 1.1, (2, 40))
    phases = generator.uniform(0, 2 * np.pi, 40)

    def disparity(at: np.ndarray) -> np.ndarray:
        return 8.0 + 0.5 * bend * (at - middle) ** 2

    images = []
    for s in (-2, -1, 0, 1, 2):
        # The camera at s sees at x what the reference sees at x + s d.
        at = x.copy()
        for _ in range(60):
            at = x + s * disparity(at)
        grey = 0.5 + 0.02 * np.cos(at[..., None] * waves[0] + y[..., None] * waves[1] + phases).sum(axis=-1)
        images.append([grey + generator.normal(0.0, noise_std, grey.shape)])
    return make_recording(images, 1000.0, 4.0), disparity(x)
