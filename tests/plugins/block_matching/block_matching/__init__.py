"""Depth by matching blocks of the reference image in the image of the next camera, to the whole pixel."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import xarray as xr
from pydantic import Field
from scipy.ndimage import uniform_filter

import scenetruth as st
from scenetruth.estimators import Method, MethodSettings, Needs
from scenetruth.progress import Progress

__all__ = ["BlockMatching"]


class Settings(MethodSettings):
    """How blocks are matched."""

    block_px: Annotated[int, Field(ge=1)] = 9
    """Side of the blocks in px, odd."""
    largest_disparity_px: Annotated[int, Field(ge=1)] = 64
    """Largest disparity that is tried, in px per step of s."""


class BlockMatching(Method):
    """The least sum of absolute differences over whole-pixel disparities."""

    name = "block_matching"
    settings = Settings
    gives = frozenset({"depth", "disparity"})
    needs = Needs(cameras=2, channels=1)

    def estimate(self, recording: xr.Dataset, settings: Settings, progress: Progress | None) -> xr.Dataset:
        """Match every frame of the reference with the camera to its right."""
        images = recording["image"].astype(np.float64)
        pairs = zip(images.sel(s=0).values, images.sel(s=1).values, strict=True)
        found = [self._match(left, right, settings) for left, right in pairs]
        return st.make_estimate(like=recording, disparity=np.stack(found))

    @staticmethod
    def _match(left: np.ndarray, right: np.ndarray, settings: Settings) -> np.ndarray:
        candidates = np.arange(1, settings.largest_disparity_px + 1)
        costs = np.full((len(candidates), *left.shape), np.inf)
        for cost, d in zip(costs, candidates, strict=True):
            cost[:, d:] = uniform_filter(np.abs(left[:, d:] - right[:, :-d]), settings.block_px)
        best: np.ndarray = candidates[np.argmin(costs, axis=0)].astype(np.float64)
        best[:, : settings.largest_disparity_px] = np.nan
        return best
