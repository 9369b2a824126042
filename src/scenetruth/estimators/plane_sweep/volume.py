"""Which hypothesis suits every pixel of the reference: costs of all of them, semi-globally, strip by strip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenetruth.estimators.plane_sweep.hypotheses import Hypotheses
from scenetruth.estimators.plane_sweep.kernels.aggregate import aggregate
from scenetruth.estimators.plane_sweep.kernels.choose import agreeing, winners
from scenetruth.estimators.plane_sweep.kernels.costs import COST_OF_BIT, PHASES, census, fill_costs, shifted
from scenetruth.estimators.plane_sweep.strips import MARGIN, ROWS, Strip, strips_of
from scenetruth.estimators.plane_sweep.views import Row
from scenetruth.threads import in_threads

__all__ = ["Chosen", "choose"]

Images = NDArray[np.float32]

# Penalties in the costs' unit, tuned on scenes/rosette.yaml, leaf.yaml and cube.yaml, with their noise and three times
# as much.
_STEP_PENALTY = 300.0  # of 1 px per step
_JUMP_PENALTY = 300.0
# Difference of grey values, in 255ths of the image's range, that halves the penalty of a jump.
_EDGE = 15.0

_MOST_BITS = 15.0
_SQUARE_PX = 5

# Memory of the strips in work.
_STRIPS_BYTES = 700e6


@dataclass(frozen=True, eq=False)
class Chosen:
    """The best hypothesis of every pixel."""

    disparity: NDArray[np.float64]
    """In columns per step, shape (y, x)."""
    distinct: NDArray[np.float64]
    """How many times as much any other answer costs, shape (y, x)."""
    bits: NDArray[np.float64]
    """Mean number of the 48 bits that differ, over a square around the pixel, shape (y, x)."""
    agreed: NDArray[np.bool_]
    """Whether the nearest view on one side at least would choose the same where it sees the point, shape (y, x)."""

    def sure(self, distinctness: float) -> NDArray[np.bool_]:
        """Mark pixels at which any other hypothesis costs so many times as much, and chance does not explain the best.

        Of unrelated neighbourhoods, 24 bits differ; the best of many hypotheses finds about 18.
        """
        return self.agreed & (self.distinct > distinctness) & (self.bits < _MOST_BITS)


def choose(images: Images, row: Row, hypotheses: Hypotheses) -> Chosen:
    """Choose among hypotheses for every pixel of the reference.

    Parameters
    ----------
    images
        Grey values, shape (s, y, x).
    row
        Which of them is the reference, and where the others stand.
    hypotheses
        Disparities.
    """
    from scipy import ndimage

    height, width = images.shape[1:]
    count = len(hypotheses.values)
    edges = _edges(images[row.reference])
    quarters = np.rint(-hypotheses.values[:, None] * row.positions * PHASES).astype(np.int64)
    whole, phase = quarters // PHASES, quarters % PHASES
    steps = np.where(hypotheses.joined, _STEP_PENALTY * hypotheses.step, _JUMP_PENALTY)
    steps = np.maximum(np.rint(steps), 1).astype(np.uint16)
    jumps = np.maximum(_JUMP_PENALTY / (1 + np.arange(256) / _EDGE), 1.5 * steps.min()).astype(np.uint16)
    apart = row.farthest * hypotheses.step
    wide, tolerance = int(np.ceil(2 / apart)), int(np.ceil(1.5 / apart))
    shifts = np.rint(-hypotheses.values[:, None] * row.nearest).astype(np.int64)
    place = np.empty((height, width))
    distinct, bits = np.empty((2, height, width))
    agreed = np.zeros((height, width), dtype=np.bool_)

    def work(strip: Strip) -> None:
        rows = slice(strip.top, strip.bottom)
        part = images[:, rows]
        reference, views = _censuses(part, row)
        costs = np.empty((*reference.shape, count), dtype=np.uint8)
        fill_costs(reference, views, whole, phase, row.left, costs)
        del views
        total = np.empty(costs.shape, dtype=np.uint16)
        aggregate(costs, edges[rows], steps, jumps, total)
        own = total[strip.first - strip.top : strip.last - strip.top]
        rows = slice(strip.first, strip.last)
        costs = costs[strip.first - strip.top : strip.last - strip.top]
        winners(own, costs, wide, place[rows], distinct[rows], bits[rows])
        for shift in shifts.T:
            agreeing(own, np.ascontiguousarray(shift), place[rows], tolerance, agreed[rows])

    per_row = width * (3 * count + 8 * (1 + PHASES * len(row.others)) + 12 * count / ROWS)
    strips = strips_of(height)
    at_once = max(1, int(_STRIPS_BYTES / (per_row * (ROWS + 2 * MARGIN))))
    for n in range(0, len(strips), at_once):
        in_threads(work, strips[n : n + at_once])
    return Chosen(hypotheses.at(place), distinct, ndimage.uniform_filter(bits / COST_OF_BIT, _SQUARE_PX), agreed)


def _censuses(images: Images, row: Row) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return the census of the reference, and those of the other views at every phase."""
    shape = images.shape[1:]
    reference = np.empty(shape, dtype=np.uint64)
    census(images[row.reference], reference)
    views = np.empty((len(row.others), PHASES, *shape), dtype=np.uint64)
    moved = np.empty(shape, dtype=np.float32)
    for n, place in enumerate(row.others):
        for phase in range(PHASES):
            shifted(images[place], phase, moved)
            census(moved, views[n, phase])
    return reference, views


def _edges(image: Images) -> NDArray[np.uint8]:
    """Return grey values over the range of an image, in which jumps of depth are looked for."""
    low, high = np.percentile(image, (1, 99))
    scaled = (image - low) * (255 / max(high - low, 1e-30))
    return np.asarray(np.clip(scaled, 0, 255), dtype=np.uint8)
