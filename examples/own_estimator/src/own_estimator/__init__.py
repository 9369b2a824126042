"""Depth and motion by gradient matching, between two cameras and between successive frames."""

from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

import scenetruth as st
from scenetruth.estimators import Method, Needs


class OwnEstimator(Method):
    """Matches each image with that of the next camera and with the next one in time."""

    name = "own_estimator"
    gives = frozenset({"depth", "disparity", "flow"})
    needs = Needs(cameras=2, frames=2, channels=1)

    def estimate(self, recording, settings, progress):
        """Estimate every frame that has a next one."""
        images = recording["image"].fillna(recording["image"].mean()).astype(float)
        frames, beside = recording["t"].values, 1 if 1 in recording["s"].values else -1
        steps = np.diff(recording["stage_x_mm"].sel(s=[0, beside]))[0] / recording.attrs["baseline_mm"]
        disparity, flow = [], []
        for done, (now, later) in enumerate(pairwise(frames)):
            here = images.sel(s=0, t=now).values
            disparity.append(-match(here, images.sel(s=beside, t=now).values)[1] / steps)
            flow.append(match(here, images.sel(s=0, t=later).values)[::-1])
            if progress is not None:
                progress("matching", done + 1, len(frames) - 1)
        disparity = np.where(np.multiply(disparity, recording.attrs["baseline_mm"]) > 0, disparity, np.nan)
        return st.make_estimate(recording=recording, t=frames[:-1], disparity=disparity, flow=np.moveaxis(flow, 0, 1))


def match(one, other, window_px=4.0, rounds=6):
    """Return the shift (dy, dx) in px that takes every pixel of one image to the other, NaN where it leaves it."""
    waves = [np.fft.rfft2(image - image.mean()) for image in (one, other)]
    peak = np.unravel_index(np.fft.irfft2(waves[0].conj() * waves[1], one.shape).argmax(), one.shape)
    size = np.array(one.shape)[:, None, None]
    shift = ((np.reshape(peak, (2, 1, 1)) + size // 2) % size - size // 2).astype(float)
    for _ in range(rounds):
        place = np.indices(one.shape) + shift
        inside = ((place > -0.5) & (place < size - 0.5)).all(axis=0)
        warped = map_coordinates(other, place, order=3, mode="mirror")
        gy, gx = np.gradient((one + warped) / 2)
        change = one - warped + gy * shift[0] + gx * shift[1]
        products = (gy * gy, gy * gx, gx * gx, gy * change, gx * change)
        yy, xy, xx, cy, cx = (gaussian_filter(inside * product, window_px) for product in products)
        scale = np.maximum(yy * xx - xy**2, 1e-6 * (yy * xx).max())
        shift = np.clip(np.array([xx * cy - xy * cx, yy * cx - xy * cy]) / scale, shift - 1, shift + 1)
    return np.where(inside, shift, np.nan)
