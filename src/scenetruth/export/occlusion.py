"""Which points of a frame the same camera does not see in the next one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenetruth.export.source import Source

__all__ = ["hidden_next"]


def hidden_next(source: Source, s: int, t: int) -> NDArray[np.bool_]:
    """Tell which points of a frame the camera does not see a frame later: hidden, or outside of the image.

    A truth tells exactly what is not seen a frame earlier or later (``occluded_in_t``), so it tells it of the first
    frame, which has no earlier one; and what of the reference camera's t = 0 other images show (``visible``). In other
    frames, points that are marked are looked for in the next one: they are seen there if the nearest pixel sees a
    surface whose plane they lie in, to within the footprint of a pixel. So outlines are known to half a pixel.

    Parameters
    ----------
    source
        A complete truth, with its recording.
    s, t
        Camera and frame; the next one must be there.

    Returns
    -------
    numpy.ndarray
        Shape (y, x); False where no surface is.
    """
    marked = source.raw("occluded_in_t", s, t).astype(bool)
    if t - 1 not in source.recording["t"].values:
        return marked
    if (s, t) == (0, 0) and "visible" in source.maps:
        return np.asarray(
            (source.raw("object_id", s, t) >= 0) & ~source.maps["visible"].sel(s=s, t=1).values.astype(bool)
        )
    rows, columns = np.nonzero(marked)
    flow = source.flow(s, t, "finite")[:, rows, columns]
    x, y = columns + flow[0], rows + flow[1]
    depth = source.depth_then(s, t, "finite")[rows, columns]
    seen = _is_seen(source, (s, t + 1), np.stack([x, y]), depth)
    hidden = marked.copy()
    hidden[rows, columns] = ~seen
    return hidden


def _is_seen(
    source: Source, place: tuple[int, int], points: NDArray[np.float64], depth: NDArray[np.float64]
) -> NDArray[np.bool_]:
    height, width = source.size
    x, y = points
    inside = (x >= -0.5) & (x <= width - 0.5) & (y >= -0.5) & (y <= height - 0.5)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    column, row = (np.clip(np.rint(along), 0, most - 1).astype(int) for along, most in ((x, width), (y, height)))
    own = source.intrinsics
    centre = own.principal_point_px

    def ray(column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        tangents = (column - centre[0]) / own.focal_length_px, (row - centre[1]) / own.focal_length_px
        return np.stack([*tangents, np.ones_like(column)])

    normal, nearest = source.map("normal", *place)[:, row, column], source.depth(*place)[row, column]
    with np.errstate(divide="ignore", invalid="ignore"):
        towards = (normal * ray(column.astype(float), row.astype(float))).sum(axis=0)
        # Where the ray of the point meets the plane of the surface that the pixel sees.
        on_plane = nearest * towards / (normal * ray(x, y)).sum(axis=0)
        return np.asarray(inside & (np.abs(on_plane - depth) < depth / own.focal_length_px))
