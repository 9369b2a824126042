"""A wedge that approaches the camera, with its truth, a noisy estimate and a recording; no rendering needed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from scenetruth.schema import (
    REASONS,
    STATUS_INVALID,
    STATUS_NORMAL,
    STATUS_VALID,
    Intrinsics,
    label,
    make_recording,
    read_intrinsics,
)
from scenetruth.schema.validity import compute_validity
from scenetruth.scoring import FigureInfo

BASELINE_MM = 5.0

HELD = (
    *("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y"),
    "velocity_epe",
)
"""What is scored of the estimates here: keys of `QUANTITIES`, the only one that is no scalar last."""

OF_ERRORS = ("Score", "rmse", "bias", "rms_z", "Error, estimate", "outlier")
"""Words that have no place where there is no truth."""


@dataclass(frozen=True)
class Case:
    """What a score needs."""

    recording: xr.Dataset
    estimate: xr.Dataset
    truth: xr.Dataset


def make_case(
    width: int = 160,
    height: int = 120,
    focal_length_px: float = 1250.0,
    *,
    frames: tuple[int, ...] = (0,),
    depth_noise_mm: float = 0.1,
    velocity_noise: float = 0.05,
    border_px: int = 4,
    seed: int = 1,
) -> Case:
    """Make a wedge with a vertical edge towards the camera, tilted by 20 degrees, 1 mm per frame nearer."""
    rng = np.random.default_rng(seed)
    intrinsics = Intrinsics(focal_length_px, ((width - 1) / 2, (height - 1) / 2), BASELINE_MM)
    wedge = [_wedge(width, height, focal_length_px, t) for t in frames]
    depth = np.stack([entry[0] for entry in wedge])
    mixed = np.stack([entry[1] for entry in wedge])
    velocity = np.where(np.isfinite(depth), np.array([0.0, 0.0, -1.0])[:, None, None, None], np.nan)
    truth = label("truth", {**_maps(depth, velocity, intrinsics), "mixed": mixed}, intrinsics, t=frames)

    noisy_depth = depth + depth_noise_mm * _noise(rng, depth.shape)
    noisy_velocity = velocity + velocity_noise * np.stack(
        [0.05 * _noise(rng, depth.shape) for _ in "XY"] + [_noise(rng, depth.shape)]
    )
    # A window across an edge rounds it off, and draws in what lies beyond a silhouette.
    filled = np.where(np.isfinite(depth), depth, 700.0)
    noisy_depth += ndimage.gaussian_filter(filled, (0, 2, 2)) - filled
    kind = np.full(depth.shape, STATUS_VALID, dtype=np.uint8)
    kind[ndimage.gaussian_filter(rng.standard_normal(depth.shape), (0, 5, 5)) > 0.14] = STATUS_NORMAL
    kind[~np.isfinite(depth)] = STATUS_INVALID
    inner = np.zeros(depth.shape, dtype=bool)
    inner[:, border_px : height - border_px, border_px : width - border_px] = True
    kind[~inner] = STATUS_INVALID
    void = kind == STATUS_INVALID
    coherence = np.clip(0.9 - 0.1 * np.abs(_noise(rng, depth.shape)), 0, 1)
    coherence[mixed] *= 0.3
    arrays = _maps(np.where(void, np.nan, noisy_depth), np.where(void, np.nan, noisy_velocity), intrinsics)
    estimate = label(
        "estimate",
        {
            **{name: values.astype(np.float32) for name, values in arrays.items()},
            "status": kind,
            "coherence": np.where(void, np.nan, coherence),
        },
        intrinsics,
        t=frames,
    )
    texture = ndimage.gaussian_filter(rng.standard_normal((height, width)), 0.005 * width)
    image = 128 + 60 * texture / texture.std()
    image[~np.isfinite(depth[len(frames) // 2])] = 20
    images = np.broadcast_to(np.clip(image, 0, 255).astype(np.uint8), (3, 3, height, width))
    return Case(make_recording(images, focal_length_px, BASELINE_MM), estimate, truth)


def with_error_bars(case: Case, seed: int = 2) -> Case:
    """Return a case whose estimate says all that it can, with normal errors of just the standard deviations it states.

    Errors of different pixels and quantities are independent; standard deviations vary over the image by about four.
    """
    rng = np.random.default_rng(seed)
    truth, kind = case.truth, case.estimate["status"].values
    shape = kind.shape
    wider = np.exp(0.35 * _noise(rng, shape))
    scales = {
        "depth": 0.1 * wider,
        "disparity": 0.004 * wider,
        "velocity": np.array([0.002, 0.003, 0.05])[:, None, None, None] * wider,
    }
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, std in scales.items():
        errors = std * rng.standard_normal(std.shape)
        arrays[name] = np.where(kind == STATUS_INVALID, np.nan, truth[name].values + errors)
        arrays[f"{name}_std"] = np.where(kind == STATUS_INVALID, np.nan, std)
    # Disparity is known at more pixels than motion: x is enough for it.
    arrays["status_disparity"] = np.where(kind == STATUS_NORMAL, STATUS_VALID, kind).astype(np.uint8)
    arrays["status_disparity"][..., ::7] = STATUS_INVALID
    arrays["status_motion"] = kind
    arrays["status"] = np.minimum(kind, arrays["status_disparity"])
    violated = {"invalid_reason": truth["mixed"].values * np.uint8(REASONS.index("model_violation"))}
    arrays |= compute_validity({"status": arrays["status"], **violated})
    arrays |= {name: case.estimate[name].values for name in ("flow", "coherence")}
    estimate = label("estimate", arrays, read_intrinsics(case.estimate), t=case.estimate["t"].values)
    return Case(case.recording, estimate, truth)


def with_regions(case: Case) -> Case:
    """Return a case whose truth tells of normals, occlusions, views and boundaries, with values made up for the test.

    Of every surface, the left tenth of the columns is hidden from some camera, the upper tenth of the rows a frame
    earlier or later, and the lower tenth of the rows is not seen throughout.
    """
    truth = case.truth
    depth = truth["depth"].values
    seen = np.isfinite(depth)
    height, width = truth.sizes["y"], truth.sizes["x"]
    y, x = np.indices((height, width))
    # From face on at the left to edge on at the right.
    angle = np.broadcast_to(np.deg2rad(90.0 * x / (width - 1)), depth.shape)
    normal = np.where(seen, np.stack([-np.sin(angle), 0 * angle, -np.cos(angle)]), np.nan)
    visible = np.ones((5, *depth.shape), dtype=bool)
    visible[3, :, y >= 0.9 * height] = False
    arrays = {
        **{name: truth[name].values for name in ("depth", "velocity", "disparity", "flow", "mixed")},
        "normal": normal,
        "occluded_across_cameras": seen & (x < 0.1 * width),
        "occluded_in_time": seen & (y < 0.1 * height),
        "visible": visible,
        "view_count": np.where(x < 0.1 * width, 4, 5) * seen,
    }
    intrinsics = read_intrinsics(truth)
    return Case(case.recording, case.estimate, label("truth", arrays, intrinsics, t=truth["t"].values))


def make_growing_case(
    width: int = 160,
    height: int = 120,
    focal_length_px: float = 1250.0,
    *,
    velocity_noise: float = 0.0,
    frame_interval_s: float = 60.0,
    seed: int = 3,
) -> Case:
    """Make an elliptic leaf, tilted by 30 degrees, that grows by 1 %/h at its left end and by 3 %/h at its right.

    The growth is along the leaf, whose own direction e is that of X in the image, and moves the leaf away from its left
    end; the leaf comes nearer by 0.5 mm per frame as a whole.
    """
    rng = np.random.default_rng(seed)
    intrinsics = Intrinsics(focal_length_px, ((width - 1) / 2, (height - 1) / 2), BASELINE_MM, frame_interval_s)
    y, x = np.indices((height, width), dtype=np.float64)
    along = np.array([np.cos(np.pi / 6), 0.0, np.sin(np.pi / 6)])
    ray_x = (x - (width - 1) / 2) / focal_length_px
    # The plane Z = 660 + tan(30 degrees) X.
    depth = 660.0 / (1.0 - np.tan(np.pi / 6) * ray_x)
    inside = ((x / (width - 1) - 0.5) / 0.45) ** 2 + ((y / (height - 1) - 0.5) / 0.42) ** 2 < 1
    place = ray_x * depth / along[0]
    start, end = place[inside].min(), place[inside].max()
    # The rate rises from 1 to 3 %/h between both ends; its integral is the velocity.
    per_frame = frame_interval_s / 3600.0 / 100.0
    path = place - start
    rate = per_frame * (1.0 + 2.0 * path / (end - start))
    speed = per_frame * (path + path**2 / (end - start))
    velocity = along[:, None, None] * speed + np.array([0.0, 0.0, -0.5])[:, None, None]
    mixed = ndimage.binary_dilation(inside) & ~ndimage.binary_erosion(inside)
    depth, rate = np.where(inside, depth, np.nan)[None], np.where(inside, rate, np.nan)[None]
    velocity = np.where(inside, velocity, np.nan)[:, None]
    arrays = {**_maps(depth, velocity, intrinsics), "mixed": mixed[None]}
    truth = label("truth", {**arrays, "growth_rate": rate}, intrinsics, t=[0])
    noisy = velocity + velocity_noise * np.stack([_noise(rng, depth.shape) for _ in "XYZ"])
    kind = np.where(inside, STATUS_VALID, STATUS_INVALID).astype(np.uint8)[None]
    estimate = label("estimate", {**_maps(depth, noisy, intrinsics), "status": kind}, intrinsics, t=[0])
    texture = _noise(rng, (1, height, width))[0]
    images = np.broadcast_to(np.clip(128 + 20 * texture, 0, 255).astype(np.uint8), (3, 3, height, width))
    recording = make_recording(images, focal_length_px, BASELINE_MM, frame_interval_s=frame_interval_s)
    return Case(recording, estimate, truth)


def with_outliers(estimate: xr.Dataset) -> xr.Dataset:
    """Return an estimate whose disparity and flow are wrong by 10 px in one column, where it has them."""
    wrong = estimate["x"] == estimate.sizes["x"] // 3
    return estimate.assign({name: estimate[name] + 10 * wrong for name in ("disparity", "flow") if name in estimate})


def of_one_camera(case: Case) -> Case:
    """Return a case whose estimate knows nothing of depth, hence of velocity either."""
    return _without(case, ("depth", "disparity", "velocity"), "status_disparity")


def of_one_frame(case: Case) -> Case:
    """Return a case whose estimate knows nothing of motion."""
    return _without(case, ("flow", "velocity"), "status_motion")


def _without(case: Case, names: tuple[str, ...], kind: str) -> Case:
    unknown = {
        name: np.nan * case.estimate[name]
        for name in (*names, *(f"{name}_std" for name in names))
        if name in case.estimate
    }
    other = {"status_disparity", "status_motion"} - {kind}
    kinds = {kind: 0 * case.estimate[kind], "status": case.estimate[other.pop()]}
    return Case(case.recording, case.estimate.assign({**unknown, **kinds}), case.truth)


def _noise(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return noise of unit variance, smooth over a few pixels as a windowed estimate's is."""
    smooth = ndimage.gaussian_filter(rng.standard_normal(shape), (0, 3, 3))
    return np.asarray(smooth / smooth.std())


def _wedge(width: int, height: int, focal_length_px: float, t: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    y, x = np.indices((height, width))
    slope_x = (x - (width - 1) / 2) / focal_length_px
    slope_y = (y - (height - 1) / 2) / focal_length_px
    # The plane Z = a + |X| + b Y meets the ray (slope_x, slope_y, 1) Z.
    depth = (660.0 - t) / (1.0 - np.abs(slope_x) - np.tan(np.deg2rad(20.0)) * slope_y)
    inside = (np.abs(slope_x * depth) < 0.4 * width / focal_length_px * 660) & (
        np.abs(slope_y * depth) < 0.43 * height / focal_length_px * 660
    )
    edge = np.abs(x - (width - 1) / 2) <= 0.5
    silhouette = ndimage.binary_dilation(inside) & ~ndimage.binary_erosion(inside)
    return np.where(inside, depth, np.nan), np.asarray(silhouette | (edge & inside))


def _maps(
    depth: NDArray[np.float64], velocity: NDArray[np.float64], intrinsics: Intrinsics
) -> dict[str, NDArray[np.float64]]:
    """Return depth and velocity with the disparity and the flow that follow from them."""
    c_x, c_y = intrinsics.principal_point_px
    y, x = np.indices(depth.shape[1:])
    scale = intrinsics.focal_length_px / depth
    flow = np.stack(
        [
            scale * velocity[0] - (x - c_x) * velocity[2] / depth,
            scale * velocity[1] - (y - c_y) * velocity[2] / depth,
        ]
    )
    return {"depth": depth, "velocity": velocity, "disparity": scale * intrinsics.baseline_mm, "flow": flow}


@dataclass(frozen=True)
class Drawn:
    """The figures of the case, and what happened while they were drawn."""

    folder: Path
    figures: list[FigureInfo]
    calls: list[tuple[str, int, int]]
    settings_kept: bool
