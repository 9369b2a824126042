"""Detection of the dots of a fiducial strip in images of the measurement."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenetruth.capture.calibration.corner_detection import opencv, stretched
from scenetruth.capture.calibration.corner_refinement import RefinedPoints, axes_of, estimate_noise, refine_dots
from scenetruth.capture.calibration.dot_detection import Blobs, find_blobs
from scenetruth.capture.calibration.rig_calibration import BoardImage
from scenetruth.capture.calibration.rig_model import CalibrationError, TargetView
from scenetruth.capture.calibration.start_values import fit_homography
from scenetruth.errors import EstimateWarning, Problem

__all__ = ["observe_strip"]

Array = NDArray[np.float64]

_BLOCKS = (20, 8, 40)
_TURN = 0.35
"""Largest sine of the angle between the strip and the image: 20 degrees."""
_NEAR = 0.3
"""Largest distance of a dot from its expected place, in units of the distance of neighbouring dots."""
_SHARE = 0.6
"""Least share of the dots that must be detected: half could be another row."""
_CERTAIN = 0.8
"""Share of the dots from which the search ends."""
_LEAST = 6
_ROW = 3
"""Least number of dots of a short row from which the other row is predicted."""
_FEW, _REMAINDER = 12, 0.1
"""Largest RMS distance of fewer than 12 dots from a homography, in units of the distance of neighbouring dots."""
_LINE = 0.02
"""Ratio of the extents of points below which they are on a line."""
_SHARE_OF_IMAGES = 0.25
_SAME_SIZE = 1.6
"""Largest ratio of the diameter of a dot to the median."""
_ROUNDS = 12


def observe_strip(
    images: Sequence[BoardImage], points_mm: ArrayLike, positions_mm: ArrayLike, *, target: int = 1, dark: bool = True
) -> list[TargetView]:
    """Detect the dots of a fiducial strip in images and return their centres with their covariance.

    Parameters
    ----------
    images
        Images of the measurement; all with one ``pose``, that no board has, and each with the number of its ``visit``.
    points_mm
        Centres of the dots, x to the right and y downwards in the images within 20°, in one plane; shape (n, 3).
    positions_mm
        Nominal X of every stage position in mm.
    target
        Index of the strip among the targets of the calibration.
    dark
        Whether the dots are darker than the strip.

    Returns
    -------
    list of TargetView
        The strip in every image in which at least 60 % of its dots were detected.

    Raises
    ------
    ValueError
        A `CalibrationError` if more than a quarter of the images do not show the strip.

    See Also
    --------
    calibrate : Accepts the views as ``strip_views``.

    Examples
    --------
    >>> import numpy as np
    >>> from scenetruth.capture.calibration import BoardImage, observe_strip
    >>> y, x = np.mgrid[:200, :300]
    >>> points = np.array([[u, v, 0.0] for v in (-8, 8) for u in range(-12, 13, 3)])
    >>> light = np.full((200, 300), 900.0)
    >>> for u, v, _ in points:
    ...     distance = np.hypot(x - 150.2 - 10 * u, y - 99.7 - 10 * v)
    ...     light -= 800 * np.clip(4.5 - distance, 0, 1)
    >>> views = observe_strip([BoardImage(light, 0, 100, visit=7)], points, [0.0])
    >>> len(views[0].pixels), views[0].visit
    (18, 7)
    >>> bool(np.abs(views[0].pixels - [150.2, 99.7] - 10 * views[0].points_mm[:, :2]).max() < 0.02)
    True
    """
    points = np.asarray(points_mm, dtype=np.float64)
    problems = list(_problems(points, images))
    if problems:
        raise CalibrationError(problems)
    opencv()
    positions = np.asarray(positions_mm, dtype=np.float64)
    views: list[TargetView] = []
    lost: list[Problem] = []
    known: tuple[float, Array] | None = None
    for number, given in enumerate(images):
        name = given.name or f"image {number}"
        image = np.asarray(given.image() if callable(given.image) else given.image, dtype=np.float64)
        x_mm = float(positions[given.position])
        match = _match(image if dark else -image, points[:, :2], known, x_mm)
        if match is None:
            lost.append(Problem(name, f"shows less than {_SHARE:.0%} of the {len(points)} dots of the strip"))
            continue
        noise = given.variance() if callable(given.variance) else given.variance
        variance = estimate_noise(image) ** 2 if noise is None else noise
        refined = _refined(image, variance, points, *match)
        if len(refined.ids) < _LEAST:
            lost.append(Problem(name, f"has {len(refined.ids)} dots of the strip that are free of other objects"))
            continue
        if not _on_a_line(points[refined.ids, :2]):
            known = (x_mm, fit_homography(points[refined.ids, :2], refined.pixels))
        views.append(
            TargetView(
                name, given.position, number if given.visit is None else given.visit, given.pose,
                points[refined.ids], refined.pixels, refined.covariance_px2, target, given.direction,
            )
        )  # fmt: skip
    if len(lost) > _SHARE_OF_IMAGES * len(images):
        raise CalibrationError(lost)
    for problem in lost:
        warnings.warn(str(problem), EstimateWarning, stacklevel=2)
    return views


def _problems(points: Array, images: Sequence[BoardImage]) -> list[Problem]:
    problems = []
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < _LEAST or not np.isfinite(points).all():
        problems.append(Problem("points_mm", f"must be at least {_LEAST} points of 3 finite coordinates", points.shape))
    elif np.ptp(points[:, 2]) > 1e-2 * np.ptp(points[:, :2]):
        problems.append(Problem("points_mm", "must lie in a plane z = constant", float(np.ptp(points[:, 2]))))
    elif _on_a_line(points[:, :2]):
        problems.append(Problem("points_mm", "must not lie on one line: use two rows", None))
    if len({image.pose for image in images}) > 1:
        problems.append(Problem("images", "must have one pose: the strip does not move"))
    return problems


def _match(
    image: Array, points: Array, known: tuple[float, Array] | None, x_mm: float
) -> tuple[NDArray[np.int64], Array, float] | None:
    """Return indices of the detected dots, their centres and their radius in px; None for too few."""
    grey = stretched(image)
    best: tuple[NDArray[np.int64], Array, float] | None = None
    for share in _BLOCKS:
        blobs = find_blobs(grey, max(grey.shape) // share)
        if len(blobs.areas) < _LEAST:
            continue
        pairs = np.empty((0, 2), dtype=np.int64)
        if known is not None:
            # A move of the camera shifts the image as an opposite move of the strip.
            shifted = points - [x_mm - known[0], 0.0]
            pairs = _followed(blobs, points, known[1], shifted, grey.shape)
        if len(pairs) < _SHARE * len(points):
            pairs = _search(blobs, points, grey.shape)
        if (
            len(pairs) >= max(_LEAST, _SHARE * len(points))
            and not _on_a_line(points[pairs[:, 0]])
            and _fits(blobs, points, pairs)
            and (best is None or len(pairs) > len(best[0]))
        ):
            radius = float(np.sqrt(np.median(blobs.areas[pairs[:, 1]]) / np.pi))
            best = (pairs[:, 0], blobs.centres[pairs[:, 1]], radius)
            if len(pairs) == len(points):
                break
    return best


def _fits(blobs: Blobs, points: Array, pairs: NDArray[np.int64]) -> bool:
    """Return whether a homography fits the pairs.

    So few spots of a texture can be near expected places by chance; many dots may deviate by the distortion of a lens.
    """
    if len(pairs) >= _FEW:
        return True
    expected = _expected(points[pairs[:, 0]], blobs.centres[pairs[:, 1]], points)
    away = blobs.centres[pairs[:, 1]] - expected[pairs[:, 0]]
    free = 2 * len(pairs) - 8
    return float((away**2).sum()) < free / 2 * (_REMAINDER * float(np.median(_spacing(expected)))) ** 2


def _apply(homography: Array, points: Array) -> Array:
    image = np.column_stack([points, np.ones(len(points))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(image[:, :2] / image[:, 2:])


def _spacing(expected: Array) -> Array:
    """Return the distance of each point from its nearest neighbour."""
    away = np.hypot(*(expected[:, None] - expected[None]).transpose(2, 0, 1))
    np.fill_diagonal(away, np.inf)
    return np.asarray(away.min(axis=1))


def _nearest(blobs: Blobs, expected: Array) -> NDArray[np.int64]:
    """Return pairs (point, blob) near their expected places, each blob once and of the usual size."""
    from scipy.spatial import cKDTree

    away, index = cKDTree(blobs.centres).query(expected)
    near = np.flatnonzero(away < _NEAR * _spacing(expected))
    if not len(near):
        return np.empty((0, 2), dtype=np.int64)
    diameters = np.sqrt(blobs.areas[index[near]])
    usual = np.median(diameters)
    near = near[(diameters < _SAME_SIZE * usual) & (diameters > usual / _SAME_SIZE)]
    _, first = np.unique(index[near], return_index=True)
    near = np.sort(near[first])
    return np.column_stack([near, index[near]])


def _settled(blobs: Blobs, points: Array, expected: Array) -> NDArray[np.int64]:
    """Return pairs after refits of a homography to the dots near expected places."""
    pairs = _nearest(blobs, expected)
    for _ in range(_ROUNDS):
        if len(pairs) < _LEAST:
            break
        again = _nearest(blobs, _expected(points[pairs[:, 0]], blobs.centres[pairs[:, 1]], points))
        if len(again) <= len(pairs) and (len(again) < len(pairs) or (again == pairs).all()):
            break
        pairs = again
    return pairs


def _missing(blobs: Blobs, points: Array, pairs: NDArray[np.int64], shape: tuple[int, ...]) -> int:
    """Return how many dots should be in the image and are not matched."""
    expected = _expected(points[pairs[:, 0]], blobs.centres[pairs[:, 1]], points)
    border = _NEAR * _spacing(expected)
    inside = (expected > border[:, None]) & (expected < [shape[1] - 1, shape[0] - 1] - border[:, None])
    return int(np.delete(inside.all(axis=1), pairs[:, 0]).sum())


def _followed(
    blobs: Blobs, points: Array, homography: Array, shifted: Array, shape: tuple[int, ...]
) -> NDArray[np.int64]:
    """Return pairs near the places where an earlier image shows the dots.

    A camera that has turned by more than half the distance of two dots shows the next dot in the place of each: the
    strip is also tried up to three dots further, unless all its dots in the image are matched.
    """
    best = _settled(blobs, points, _apply(homography, shifted))
    highest = _score(blobs, points, best, shape)
    if len(best) and highest == len(best):
        return best
    for step in _steps(points):
        for count in (-3, -2, -1, 1, 2, 3):
            pairs = _settled(blobs, points, _apply(homography, shifted + count * step))
            score = _score(blobs, points, pairs, shape)
            if score > highest:
                best, highest = pairs, score
    return best


def _steps(points: Array) -> Array:
    """Return the vectors, up to their sign, from points to their nearest neighbours that occur most often: up to 2."""
    vectors = points[None] - points[:, None]
    lengths = np.hypot(vectors[..., 0], vectors[..., 1])
    np.fill_diagonal(lengths, np.inf)
    nearest = vectors[np.arange(len(points)), lengths.argmin(axis=1)]
    nearest[(nearest[:, 0] < 0) | ((nearest[:, 0] == 0) & (nearest[:, 1] < 0))] *= -1
    unit = 0.1 * float(lengths.min())
    _, first, counts = np.unique(np.rint(nearest / unit), axis=0, return_index=True, return_counts=True)
    return np.asarray(nearest[first[np.argsort(-counts, kind="stable")[:2]]])


def _score(blobs: Blobs, points: Array, pairs: NDArray[np.int64], shape: tuple[int, ...]) -> int:
    """Return the number of matched dots less that of dots that are lacking in the image.

    A row that is shifted by a dot lacks one in the image; a row that is cut off does not.
    """
    return len(pairs) - _missing(blobs, points, pairs, shape) if len(pairs) >= _LEAST else 0


def _search(blobs: Blobs, points: Array, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return pairs (point, blob) of the upright strip: the best of all similarities by two neighbouring dots."""
    from scipy.spatial import cKDTree

    tree = cKDTree(blobs.centres)
    _, near = tree.query(blobs.centres, k=min(7, len(blobs.centres)))
    vectors = points[:, None] - points[None]
    lengths = np.hypot(vectors[..., 0], vectors[..., 1])
    np.fill_diagonal(lengths, np.inf)
    least = _least_of_row(lengths)
    best, highest = np.empty((0, 2), dtype=np.int64), 0
    for one in range(len(blobs.centres)):
        for other in np.atleast_1d(near[one])[1:].tolist():
            step = blobs.centres[other] - blobs.centres[one]
            for start in range(len(points)):
                end = int(lengths[start].argmin())
                nominal = points[end] - points[start]
                turn = (nominal[0] * step[1] - nominal[1] * step[0]) / (np.hypot(*nominal) * np.hypot(*step))
                if abs(turn) > _TURN or nominal @ step <= 0:
                    continue
                pairs = _grown(blobs, tree, points, lengths, least[start], (start, one), (end, other))
                if len(pairs) < _LEAST:
                    continue
                score = _score(blobs, points, pairs, shape)
                if score > highest:
                    best, highest = pairs, score
            if highest >= _CERTAIN * len(points):
                return _settled_from(blobs, points, best)
    return _settled_from(blobs, points, best)


def _settled_from(blobs: Blobs, points: Array, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    if len(pairs) < _LEAST:
        return pairs
    return _settled(blobs, points, _expected(points[pairs[:, 0]], blobs.centres[pairs[:, 1]], points))


def _on_a_line(points: Array) -> bool:
    """Return whether points, shape (n, 2), do not determine a homography."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] < _LINE * spread[0])


def _expected(points: Array, seen: Array, all_points: Array) -> Array:
    """Return the places of all points by a homography, or by a similarity if the points seen do not determine it."""
    if not (_on_a_line(points) or _on_a_line(seen)):
        found = _apply(fit_homography(points, seen), all_points)
        if np.isfinite(found).all():
            return found
    return _similar(points, seen, all_points)


def _grown(
    blobs: Blobs, tree: object, points: Array, lengths: Array, least: int, one: tuple[int, int], other: tuple[int, int]
) -> NDArray[np.int64]:
    """Return pairs that continue two correspondences from dot to dot along a row, then to the other row.

    Two pairs are returned if a similarity of them does not fit.
    """
    found = dict((one, other))
    spacing = float(lengths[one[0], other[0]])
    lacking: set[int] = set()
    while True:
        where = np.array(list(found))
        seen = blobs.centres[list(found.values())]
        expected = _similar(points[where], seen, points)
        scale = np.hypot(*(expected[other[0]] - expected[one[0]])) / spacing
        # The next dots are those nearest to the matched dots.
        rest = np.setdiff1d(np.arange(len(points)), [*where, *lacking])
        if not len(rest):
            break
        gap = lengths[np.ix_(rest, where)].min(axis=1)
        jumps = len(found) >= _LEAST or (len(found) >= least and not (gap <= 1.05 * spacing).any())
        reach = max(1.05 * spacing, 1.01 * float(gap.min()) if jumps else 0.0)
        before = len(found)
        for point in rest[gap <= reach].tolist():
            anchor = int(where[lengths[point, where].argmin()])
            guess = blobs.centres[found[anchor]] + expected[point] - expected[anchor]
            away, blob = tree.query(guess)  # type: ignore[attr-defined]
            if away < _NEAR * spacing * scale and blob not in found.values():
                found[point] = int(blob)
            elif len(found) >= least:
                lacking.add(point)
        if len(found) == before and len(found) < least:
            break
    return np.array(sorted(found.items()), dtype=np.int64)


def _least_of_row(lengths: Array) -> list[int]:
    """Return how many dots of the row of each point must be detected before those of the other row are predicted."""
    from scipy.sparse.csgraph import connected_components

    nearest = lengths.min(axis=1)
    _, row = connected_components(lengths <= 1.05 * np.minimum(nearest, nearest[:, None]), directed=False)
    share = np.ceil(_SHARE * np.bincount(row)[row]).astype(int)
    return [int(count) for count in np.clip(share, _ROW, _LEAST)]


def _similar(points: Array, seen: Array, all_points: Array) -> Array:
    """Return all points by the similarity that fits the points seen."""
    plane, image = points @ [1, 1j], seen @ [1, 1j]
    centred = plane - plane.mean()
    factor = np.vdot(centred, image) / np.vdot(centred, centred)
    moved = image.mean() + factor * (all_points @ [1, 1j] - plane.mean())
    return np.column_stack([moved.real, moved.imag])


def _refined(
    image: Array, variance: Array | float, points: Array, ids: NDArray[np.int64], centres: Array, radius_px: float
) -> RefinedPoints:
    """Return the centroids of matched dots with their covariance, without dots that other objects touch."""
    flat = points[ids, :2]
    axes = axes_of(fit_homography(flat, centres), flat)
    # One radius in mm for all dots: the image of each is that of a disc.
    scale = np.sqrt(np.abs(np.linalg.det(axes)))
    axes = axes * (radius_px / float(np.median(scale)))
    return refine_dots(image, variance, ids, centres, axes, neighbour_radii=float(_spacing(centres).min()) / radius_px)
