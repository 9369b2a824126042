"""Depth by matching blocks of the reference image in the image of the next camera, to the whole pixel."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import xarray as xr
from pydantic import Field
from scipy.ndimage import uniform_filter

import scenetruth as st
from scenetruth.errors import EstimateError, Problem
from scenetruth.estimators import Method, MethodSettings, Needs
from scenetruth.progress import Progress
from scenetruth.schema import compute_pixel_grid

__all__ = ["BlockMatching"]


class Settings(MethodSettings):
    """How blocks are matched."""

    block_px: Annotated[int, Field(ge=1)] = 9
    """Side of the blocks in px, odd."""
    largest_disparity_px: Annotated[int, Field(ge=1)] = 64
    """Largest disparity that is tried, in columns per step of s."""


class BlockMatching(Method):
    """The least sum of absolute differences over whole-pixel disparities."""

    name = "block_matching"
    settings = Settings
    gives = frozenset({"depth", "disparity"})
    needs = Needs(cameras=2, channels=1)

    def requirements(self, recording: xr.Dataset, settings: Settings) -> list[Problem]:
        """Ask for the camera beside the reference, and for images that are wider than the largest disparity."""
        problems = []
        if 1 not in recording["s"].values:
            problems.append(Problem("stage.positions", "the camera s = 1 is needed"))
        if settings.largest_disparity_px >= recording.sizes["x"]:
            message = f"must be less than the images' width, {recording.sizes['x']}"
            problems.append(Problem("estimate.largest_disparity_px", message, settings.largest_disparity_px))
        return problems

    def estimate(self, recording: xr.Dataset, settings: Settings, progress: Progress | None) -> xr.Dataset:
        """Match every frame of the reference with the camera to its right."""
        images = recording["image"].sel(s=[0, 1]).astype(np.float64)
        if not np.isfinite(images).all():
            raise EstimateError([Problem("image", "holds values that are not finite")])
        found = []
        for left, right in zip(images.sel(s=0).values, images.sel(s=1).values, strict=True):
            found.append(self._match(left, right, settings))
            if progress is not None:
                progress("match", len(found), recording.sizes["t"])
        # From columns of the array to pixels of the camera.
        disparity = np.stack(found) * compute_pixel_grid(recording).step_px
        return st.make_estimate(recording=recording, disparity=disparity)

    @staticmethod
    def _match(left: np.ndarray, right: np.ndarray, settings: Settings) -> np.ndarray:
        candidates = np.arange(1, settings.largest_disparity_px + 1)
        costs = np.full((len(candidates), *left.shape), np.inf)
        for cost, d in zip(costs, candidates, strict=True):
            cost[:, d:] = uniform_filter(np.abs(left[:, d:] - right[:, :-d]), settings.block_px)
        best: np.ndarray = candidates[np.argmin(costs, axis=0)].astype(np.float64)
        best[:, : settings.largest_disparity_px] = np.nan
        return best
