"""Kernels of the fallback: surfaces as connected pixels, planes through them, and planes carried along geodesics."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from scenetruth.kernels import kernel

__all__ = [
    "ExtensionRules",
    "SurfacePlanes",
    "carry_sources",
    "extend_planes",
    "fit_planes",
    "fit_surfaces",
    "label_surfaces",
    "look_around",
]

_jit = kernel(error_model="numpy")


@_jit
def _root(parent: Any, place: Any) -> Any:
    while parent[place] != place:
        parent[place] = parent[parent[place]]
        place = parent[place]
    return place


@_jit
def label_surfaces(disparity: Any, source: Any, jump: float, labels: Any) -> None:
    """Label sources that are connected by steps of disparity of at most ``jump``; -1 elsewhere.

    ``disparity``: Disparity, float64 of shape (y, x).
    ``source``: Where it may be used, bool of shape (y, x).
    ``labels``: Output: index of one pixel of the surface, int32 of shape (y, x).
    """
    height, width = disparity.shape
    parent = labels.reshape(height * width)
    for y in range(height):
        for x in range(width):
            here = y * width + x
            if not source[y, x]:
                parent[here] = -1
                continue
            parent[here] = here
            for n in range(2):
                v, u = (y, x - 1) if n == 0 else (y - 1, x)
                if v >= 0 and u >= 0 and source[v, u] and abs(disparity[y, x] - disparity[v, u]) <= jump:
                    a, b = _root(parent, here), _root(parent, v * width + u)
                    if a < b:
                        parent[b] = a
                    else:
                        parent[a] = b
    for here in range(height * width):
        if parent[here] >= 0:
            parent[here] = _root(parent, here)


@_jit
def _solve(s: Any, prior: Any, plane: Any) -> None:
    """Write the plane through weighted sums (w, wx, wy, wxx, wxy, wyy, wd, wxd, wyd, wdd) about its centroid.

    ``plane``: Output: centroid x and y, disparity there, slopes, mean square deviation, and variances of disparity and
      slopes for deviations of variance 1.
    """
    mx, my, md = s[1] / s[0], s[2] / s[0], s[6] / s[0]
    cxx, cxy, cyy = s[3] - s[0] * mx * mx + prior, s[4] - s[0] * mx * my, s[5] - s[0] * my * my + prior
    cxd, cyd = s[7] - s[0] * mx * md, s[8] - s[0] * my * md
    det = cxx * cyy - cxy * cxy
    plane[0], plane[1], plane[2] = mx, my, md
    plane[3], plane[4] = (cyy * cxd - cxy * cyd) / det, (cxx * cyd - cxy * cxd) / det
    plane[5] = max((s[9] - s[0] * md * md - plane[3] * cxd - plane[4] * cyd) / s[0], 0.0)
    plane[6], plane[7], plane[8] = 1.0 / s[0], cyy / det, cxx / det


@_jit
def _add(sums: Any, w: Any, x: Any, y: Any, d: Any) -> None:
    sums[0] += w
    sums[1] += w * x
    sums[2] += w * y
    sums[3] += w * x * x
    sums[4] += w * x * y
    sums[5] += w * y * y
    sums[6] += w * d
    sums[7] += w * x * d
    sums[8] += w * y * d
    sums[9] += w * d * d


@_jit
def fit_planes(
    first: int, last: int, places: Any, disparity: Any, weight: Any, labels: Any, reach: int, prior: float, planes: Any
) -> None:
    """Fit a plane around each source of a band, to the pixels of the same surface within a radius.

    ``places``: Indices of the sources, int64 of shape (n,).
    ``weight``: Weights of the disparities, float64 of shape (y, x).
    ``labels``: Surface of every source, else -1; int32 of shape (y, x).
    ``reach``: Radius in px.
    ``prior``: Inverse variance of the slopes, whose prior is zero, for deviations of variance 1.
    ``planes``: Output: plane as in `_solve` relative to the source, and lowest and highest disparity; shape (n, 11).
    """
    height, width = disparity.shape
    sums = np.empty(10)
    for n in range(first, last):
        y0, x0 = places[n] // width, places[n] % width
        label, own = labels[y0, x0], disparity[y0, x0]
        sums[:] = 0.0
        low, high = 0.0, 0.0
        for y in range(max(y0 - reach, 0), min(y0 + reach + 1, height)):
            for x in range(max(x0 - reach, 0), min(x0 + reach + 1, width)):
                if labels[y, x] == label and (x - x0) ** 2 + (y - y0) ** 2 <= reach * reach:
                    d = disparity[y, x] - own
                    low, high = min(low, d), max(high, d)
                    _add(sums, weight[y, x], float(x - x0), float(y - y0), d)
        _solve(sums, prior, planes[n])
        planes[n, 0] += x0
        planes[n, 1] += y0
        planes[n, 2] += own
        planes[n, 9], planes[n, 10] = own + low, own + high


@_jit
def fit_surfaces(disparity: Any, weight: Any, labels: Any, numbers: Any, prior: float, planes: Any) -> None:
    """Fit one plane to each whole surface.

    ``numbers``: Number of the surface of every label, int32 of shape (n,).
    ``planes``: Output: planes as in `_solve`, by number of the surface, shape (surfaces, 9).
    """
    height, width = disparity.shape
    sums, own = np.zeros((len(planes), 10)), np.zeros((len(planes), 3))
    for y in range(height):
        for x in range(width):
            if labels[y, x] >= 0:
                n = numbers[labels[y, x]]
                if sums[n, 0] == 0.0:
                    own[n, 0], own[n, 1], own[n, 2] = float(x), float(y), disparity[y, x]
                _add(sums[n], weight[y, x], x - own[n, 0], y - own[n, 1], disparity[y, x] - own[n, 2])
    for n in range(len(planes)):
        _solve(sums[n], prior, planes[n])
        for k in range(3):
            planes[n, k] += own[n, k]


@_jit
def _extend(plane: Any, x: Any, y: Any, least: Any, correlated: Any) -> tuple[Any, Any]:
    """Return disparity and variance of a plane at a pixel, without the deviations of the surface from the plane."""
    dx, dy = x - plane[0], y - plane[1]
    variance = max(plane[5], least) * correlated
    value = plane[2] + plane[3] * dx + plane[4] * dy
    return value, variance * (plane[6] + plane[7] * dx * dx + plane[8] * dy * dy)


class SurfacePlanes(NamedTuple):
    """Planes of surfaces.

    ``near``, ``near_of``: Planes around sources, and the row of each source among them.
    ``whole``, ``numbers``: Planes of whole surfaces, and the number of the surface of every label.
    """

    near: Any
    near_of: Any
    whole: Any
    numbers: Any


class ExtensionRules(NamedTuple):
    """How planes are extended.

    ``least``: Smallest mean square deviation from a plane.
    ``correlated``: Number of pixels whose errors are common.
    ``clip``: Largest difference from the disparities around the source.
    ``distance``, ``edge``, ``jump``: Largest additional cost and edge, and smallest difference of disparity, of a
      farther surface that is preferred.
    ``scale``: Difference of costs by which a surface is less probable by a factor of e.
    """

    least: float
    correlated: float
    clip: float
    distance: float
    edge: float
    jump: float
    scale: float


@_jit
def extend_planes(
    first: int,
    last: int,
    paths: Any,
    labels: Any,
    planes: SurfacePlanes,
    rules: ExtensionRules,
    value: Any,
    variance: Any,
    chosen: Any,
) -> None:
    """Extend the planes of the nearest surfaces to the pixels of a band of rows, and choose one.

    The plane around a source and that of its whole surface are averaged by their variances, and clipped to the
    disparities around the source. Of two surfaces that are about equally near, without an edge between, the farther one
    is chosen: the nearer one ends at its outline.

    ``paths``: Costs, edges and sources of `carry_sources`.
    ``value``, ``variance``: Output: disparity, and variance of planes and of the choice between surfaces; (y, x).
    ``chosen``: Output: source of the chosen surface, int32 of shape (y, x); unchanged without any.
    """
    costs, edges, sources = paths
    width, count = costs.shape[1:]
    values, variances = np.empty(count), np.empty(count)
    for y in range(first, last):
        for x in range(width):
            if labels[y, x] >= 0 or sources[y, x, 0] < 0:
                continue
            pick = 0
            for k in range(count):
                source = sources[y, x, k]
                if source < 0:
                    break
                plane = planes.near[planes.near_of[source]]
                surface = planes.whole[planes.numbers[labels[source // width, source % width]]]
                local, of_local = _extend(plane, float(x), float(y), rules.least, rules.correlated)
                wide, of_wide = _extend(surface, float(x), float(y), rules.least, rules.correlated)
                # Surfaces are curved.
                of_wide += max(surface[5], rules.least)
                mean = (local * of_wide + wide * of_local) / (of_local + of_wide)
                values[k] = min(max(mean, plane[9] - rules.clip), plane[10] + rules.clip)
                variances[k] = of_local * of_wide / (of_local + of_wide) + (values[k] - mean) ** 2
                if (
                    costs[y, x, k] < costs[y, x, 0] + rules.distance
                    and edges[y, x, k] <= edges[y, x, 0] + rules.edge
                    and abs(values[k]) < abs(values[pick]) - rules.jump
                ):
                    pick = k
            sums = square = 0.0
            for k in range(count):
                if sources[y, x, k] < 0:
                    break
                weight = np.exp(-max(costs[y, x, k] - costs[y, x, pick], 0.0) / rules.scale)
                sums += weight
                square += weight * (values[k] - values[pick]) ** 2
            value[y, x], variance[y, x] = values[pick], variances[pick] + square / sums
            chosen[y, x] = sources[y, x, pick]


@_jit
def _offer(costs: Any, edges: Any, sources: Any, labels: Any, cost: Any, edge: Any, place: Any) -> bool:
    """Offer a source to a pixel, which keeps the nearest one of each of its nearest surfaces, in ascending order."""
    count = len(costs)
    if not cost < costs[count - 1]:
        return False
    label = labels[place]
    slot = 0
    while costs[slot] <= cost:
        if labels[sources[slot]] == label:
            return False
        slot += 1
    # The slot of the same surface is freed, else the last one.
    last = slot
    while last < count - 1 and sources[last] >= 0 and labels[sources[last]] != label:
        last += 1
    for n in range(last, slot, -1):
        costs[n], edges[n], sources[n] = costs[n - 1], edges[n - 1], sources[n - 1]
    costs[slot], edges[slot], sources[slot] = cost, edge, place
    return True


@_jit
def carry_sources(
    grey: Any, labels: Any, contrast: float, noise: float, rounds: int, costs: Any, edges: Any, sources: Any
) -> None:
    """Carry the nearest sources of several surfaces to every pixel that is none, along paths of least cost.

    A step of length l costs l + contrast |Δgrey|. Raster sweeps in all directions are repeated until nothing changes,
    or the paths have turned as often as ``rounds`` allows.

    ``grey``: Grey values, float32 of shape (y, x).
    ``labels``: Surface of every pixel that is a source, else -1; int32, shape (n,).
    ``noise``: Differences of grey values up to this are no edges.
    ``costs``: 0 in the first slot of a source, else infinite; output: least costs, float32 of shape (y, x, k).
    ``edges``: Zero; output: sums of the differences beyond noise along these paths, float32 of shape (y, x, k).
    ``sources``: Index of the pixel itself in the first slot of a source, else -1; output: the sources, int32 of the
      same shape.
    """
    height, width = grey.shape
    count = costs.shape[2]
    of_step, unsure = np.float32(contrast), np.float32(noise)
    dirty = np.ones((2, height), dtype=np.bool_)
    for turn in range(2 * rounds):
        down = turn % 2 == 0
        now, coming = dirty[turn % 2], dirty[1 - turn % 2]
        coming[:] = False
        changed_before = False
        any_change = False
        for row in range(height):
            y = row if down else height - 1 - row
            v = y - 1 if down else y + 1
            if not (now[y] or changed_before):
                continue
            changed = False
            for back in range(2):
                for column in range(width):
                    x = column if back == 0 else width - 1 - column
                    if labels[y * width + x] >= 0:
                        continue
                    for n in range(4 if back == 0 else 1):
                        if n == 3:
                            w, u = y, x - 1
                        elif back == 1:
                            w, u = y, x + 1
                        else:
                            w, u = v, x + n - 1
                        if not (0 <= w < height and 0 <= u < width):
                            continue
                        step = abs(grey[y, x] - grey[w, u])
                        length = np.float32(1.0) if w == y or u == x else np.float32(1.4142135)
                        length += of_step * step
                        edge = max(step - unsure, np.float32(0.0))
                        for k in range(count):
                            place = sources[w, u, k]
                            if place < 0:
                                break
                            cost = costs[w, u, k] + length
                            changed |= _offer(
                                costs[y, x], edges[y, x], sources[y, x], labels, cost, edges[w, u, k] + edge, place
                            )
            changed_before = changed
            if changed:
                any_change = True
                # The next sweep, in the other direction, begins with these rows.
                coming[y] = True
                if 0 <= v < height:
                    coming[v] = True
        if turn > 0 and not any_change:
            break


@_jit
def look_around(labels: Any, chosen: Any, reach: int, pairs: Any) -> None:
    """Count, of the four lines through every pixel that is no source, those with the chosen surface at both ends.

    ``labels``: Surface of every pixel that is a source, else -1; int32 of shape (y, x).
    ``chosen``: Surface chosen at every pixel, int32 of shape (y, x).
    ``reach``: Longest distance to an end, in px.
    ``pairs``: Zero; output: number of lines, uint8 of shape (y, x).
    """
    height, width = labels.shape
    seen = np.empty((2, width + 2), dtype=np.int32)
    ages = np.empty((2, width + 2), dtype=np.int32)
    ahead = np.empty((height, width), dtype=np.bool_)
    for line in range(4):
        dy, dx = (0, 1) if line == 0 else (1, line - 2)
        for back in range(2):
            seen[:], ages[:] = -1, 0
            for row in range(height):
                y = row if back == 1 else height - 1 - row
                old, new = row % 2, (row + 1) % 2
                if dy == 0:
                    label, age = -1, 0
                    for column in range(width):
                        x = column if back == 1 else width - 1 - column
                        age += 1
                        if labels[y, x] >= 0:
                            label, age = labels[y, x], 0
                        agrees = label == chosen[y, x] and age <= reach
                        if back == 0:
                            ahead[y, x] = agrees
                        elif agrees and ahead[y, x]:
                            pairs[y, x] += 1
                    continue
                for x in range(width):
                    side = x + 1 - (dx if back == 1 else -dx)
                    label, age = seen[old, side], ages[old, side] + 1
                    if labels[y, x] >= 0:
                        label, age = labels[y, x], 0
                    seen[new, x + 1], ages[new, x + 1] = label, age
                    agrees = label == chosen[y, x] and age <= reach
                    if back == 0:
                        ahead[y, x] = agrees
                    elif agrees and ahead[y, x]:
                        pairs[y, x] += 1
                seen[new, 0], seen[new, width + 1] = -1, -1
