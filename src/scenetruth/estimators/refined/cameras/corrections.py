"""How far the images of a window are from where they should be, as far as is known after each round."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.refined.cameras.effect import Effect, effect_of
from scenetruth.estimators.refined.cameras.equations import Elimination, blocks_of
from scenetruth.estimators.refined.cameras.points import CORRECTIONS
from scenetruth.estimators.refined.cameras.shifts import Shifts
from scenetruth.estimators.refined.images import Images
from scenetruth.estimators.refined.noise import spline_transfer
from scenetruth.estimators.refined.settings import CorrectionPriors

__all__ = ["Cameras"]

# Blocks that leave this many times what half of them leave are left out: what moves there is no point.
_OUTLIER = 4.0
_PASSES = 3
_STILL = 0.1

Array = NDArray[np.float64]


class Cameras:
    """Corrections of all images and their covariance.

    An image is off by what its position is off at every visit and by what is new at each; the image of the reference
    position in the estimated frame stands where it should by definition, and all others are off against it.

    Parameters
    ----------
    priors
        Standard deviations of what images are off before anything is known of them.
    images
        The images.
    """

    def __init__(self, priors: CorrectionPriors, images: Images) -> None:
        view = images.view()
        count, cameras = len(view.s), len(images.positions)
        fresh = (priors.repeatability_px, priors.repeatability_px)
        fixed = (priors.x_px, priors.y_px, 1e-6 * priors.roll_urad, 1e-6 * priors.scale_ppm)
        # Unknown are the errors of positions, then those of single visits, each in units of its standard deviation.
        parts = np.zeros((count, CORRECTIONS, cameras * len(fixed) + count * len(fresh)))
        for n in range(count):
            for k, std in enumerate(fixed):
                parts[n, k, (n % cameras) * len(fixed) + k] = std
            for k, std in enumerate(fresh):
                parts[n, k, cameras * len(fixed) + n * len(fresh) + k] = std
        reference = np.flatnonzero((view.s == 0) & (view.s_y == 0) & (view.t == 0))
        if reference.size:
            parts = parts - parts[reference[0]]
        told = np.abs(parts).max(axis=(0, 1)) > 0
        self._parts = parts[..., told].reshape(count * CORRECTIONS, -1)
        self._times = view.t
        self._unknown = np.zeros(self._parts.shape[1])
        self._covariance: Array = np.eye(len(self._unknown))

    @property
    def values(self) -> Array:
        """Corrections in the order of `Images.stack`, shape (n, 4): along x and y in px, roll in rad, scale."""
        return np.asarray((self._parts @ self._unknown).reshape(-1, CORRECTIONS))

    @property
    def std(self) -> Array:
        """Standard deviations of `values`."""
        variance = np.einsum("cu,uv,cv->c", self._parts, self._covariance, self._parts, optimize=True)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)).reshape(-1, CORRECTIONS))

    def update(self, shifts: Shifts, fields: Array, images: Images) -> float:
        """Take into account what blocks of pixels tell, and return by how many px an image moved at most.

        What stays within a tenth of its standard deviation does not count.

        Parameters
        ----------
        shifts
            The sums over blocks, of some frames' images at their latest corrections.
        fields
            d, q_X, q_Y and q_Z of every pixel by which they were warped, shape (4, y, x).
        images
            The images of these frames.
        """
        blocks, view = blocks_of(shifts, fields), images.view()
        if not len(blocks.shift) or not blocks.noise > 0:
            return 0.0
        taken = np.repeat(np.isin(self._times, images.times), CORRECTIONS)
        parts, before = self._parts[taken], self.values
        elimination = Elimination(blocks, view)
        kept: Array = np.ones(len(blocks.shift))
        excess = 1.0
        unknown: Array = self._unknown
        for _ in range(_PASSES):
            told = elimination.equations(kept)
            noise = excess * (blocks.noise / spline_transfer(images.spline)) ** 2
            matrix = parts.T @ told.matrix @ parts / noise
            side = parts.T @ told.side / noise - self._unknown
            covariance = np.asarray(np.linalg.inv(matrix + np.eye(len(matrix))), dtype=np.float64)
            step = covariance @ side
            unknown = self._unknown + step
            left = elimination.misfit((parts @ step).reshape(-1, CORRECTIONS))
            usual = float(np.median(left))
            kept = (left < _OUTLIER * usual).astype(np.float64)
            # Where blocks leave more than noise, their shifts err by more.
            excess = max(1.0, float(left[kept > 0].mean())) if kept.any() else 1.0
            self._covariance = covariance
        self._unknown = unknown
        change = np.abs(self.values - before)
        arm = max(images.shape) / 2
        moved = np.where(change > _STILL * self.std, change, 0.0) * np.array([1.0, 1.0, arm, arm])
        return float(moved.max())

    def effect(self, images: Images, fields: Array) -> Effect:
        """Return what the corrections' uncertainty does to disparity and velocity.

        Parameters
        ----------
        images
            The images.
        fields
            d, q_X, q_Y and q_Z of every pixel, finite, shape (4, y, x).
        """
        rooted = self._parts @ np.linalg.cholesky(self._covariance)
        return effect_of(images.view(), fields, rooted)
