"""Finding the likely slips of an estimate."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from scenetruth.errors import Problem, ScoreError
from scenetruth.schema import intrinsics_of, label
from scenetruth.scoring.slips.hypothesis import RIGHT
from scenetruth.scoring.slips.material import Material, read_materials
from scenetruth.scoring.slips.search import likely_slips
from scenetruth.scoring.slips.shift import fitted_shift
from scenetruth.scoring.slips.slip import Slip

__all__ = ["find_slips", "slips_of_arrays"]

_COMPONENTS = {"flow": 2, "velocity": 3}


def find_slips(estimate: xr.Dataset, truth: xr.Dataset) -> list[Slip]:
    """Return the likely slips of convention in an estimate: signs, units, order, origin, one frame or pixel off.

    Every combination of a slip of place (maps upside down, mirrored, transposed, of another frame), one of meaning
    (signs, order of components, the distance along the ray, disparity for depth) and one of scale (units, steps, time)
    is compared with the estimate being right, for each of depth, disparity, flow and velocity. One is named where
    undoing it takes away most of the misfit at the pixels that it changes, beyond what a gain of up to 5 % does: errors
    of a method, as noise, blur, outliers and bias, are not taken away so. Of several that explain alike the simplest is
    named. Shifts by one and by half a pixel are measured from the gradients of the truth away from edges, and named
    where they are many standard errors from zero.

    What does not show is not named: the sign of a motion that is zero, a plane that is the same upside down. Of large
    data sets, three frames and some thousand pixels are looked at.

    Parameters
    ----------
    estimate
        The estimate, dimensions (t, y, x); the sign of depth and disparity may be any.
    truth
        The truth, dimensions (t, y, x), or (s, t, y, x), of which s = 0 is taken; it may have more frames and pixels.

    Returns
    -------
    list of Slip
        By quantity; empty if the estimate shows none.

    Raises
    ------
    ScoreError
        If the data sets cannot be compared; lists what is wrong.

    See Also
    --------
    slips_of_arrays : The same of plain arrays, before an estimate is made of them.

    Examples
    --------
    A tilted plane, and a method that tells depth in metres:

    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=100.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> depth = 500.0 + np.mgrid[:24, :32][1:] * 2.0
    >>> still = np.zeros((3, *depth.shape))
    >>> maps = {"depth": depth, "disparity": 500 / depth, "velocity": still, "flow": still[:2], "mixed": depth < 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 0.001 * depth}, camera, t=[0])
    >>> [(slip.kind, slip.quantity) for slip in find_slips(estimate, truth)]
    [('metres', 'depth')]
    >>> find_slips(label("estimate", {"depth": 1.01 * depth}, camera, t=[0]), truth)
    []
    """
    wrong = [
        Problem(name, "must be an xarray.Dataset", type(part).__name__)
        for name, part in (("estimate", estimate), ("truth", truth))
        if not isinstance(part, xr.Dataset)
    ]
    if wrong:
        raise ScoreError(wrong)
    with np.errstate(over="ignore", invalid="ignore"):
        return [slip for material in read_materials(estimate, truth) for slip in _slips_of(material)]


def slips_of_arrays(
    truth: xr.Dataset,
    *,
    depth: ArrayLike | None = None,
    disparity: ArrayLike | None = None,
    flow: ArrayLike | None = None,
    velocity: ArrayLike | None = None,
    t: ArrayLike | None = None,
) -> list[Slip]:
    """Return the likely slips in plain arrays, which `make_estimate` may refuse: a negative depth, say.

    Parameters
    ----------
    truth
        The truth, dimensions (t, y, x), or (s, t, y, x), of which s = 0 is taken; the arrays have its pixels.
    depth, disparity
        In mm and in px per step of s, shape (t, y, x), or (y, x) for one frame.
    flow, velocity
        In px and in mm per frame, shapes (2, ...) and (3, ...).
    t
        The frames of the arrays. If not given: all frames of the truth if there are as many, the reference frame for a
        single one.

    Returns
    -------
    list of Slip
        As of `find_slips`.

    Raises
    ------
    ScoreError
        If the arrays cannot be compared with the truth; lists what is wrong.

    Examples
    --------
    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=100.0, principal_point_px=(15.5, 11.5), baseline_mm=5.0)
    >>> depth = 500.0 + np.mgrid[:24, :32][1:] * 2.0
    >>> still = np.zeros((3, *depth.shape))
    >>> maps = {"depth": depth, "disparity": 500 / depth, "velocity": still, "flow": still[:2], "mixed": depth < 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> [slip.kind for slip in slips_of_arrays(truth, depth=-depth[0])]
    ['sign']
    """
    if not isinstance(truth, xr.Dataset):
        raise ScoreError([Problem("truth", "must be an xarray.Dataset", type(truth).__name__)])
    size = tuple(truth.sizes[dim] for dim in ("y", "x") if dim in truth.sizes)
    given = {"depth": depth, "disparity": disparity, "flow": flow, "velocity": velocity}
    problems: list[Problem] = []
    arrays: dict[str, NDArray[np.float64]] = {}
    for name, values in given.items():
        if values is not None:
            found = _with_frames(values, _COMPONENTS.get(name), size)
            if found is None:
                lead = f"{_COMPONENTS[name]}, " if name in _COMPONENTS else ""
                message = (
                    f"must hold real numbers in the shape ({lead}t, y, x), or that without t, with (y, x) = {size}"
                )
                problems.append(Problem(name, message, np.shape(values)))
            else:
                arrays[name] = found
    counts = {name: values.shape[-3] for name, values in arrays.items()}
    if not (arrays or problems):
        problems.append(Problem("", "at least one of depth, disparity, flow, velocity is needed"))
    if len(set(counts.values())) > 1:
        problems.append(Problem("", "arrays hold different numbers of frames", counts))
    if problems:
        raise ScoreError(problems)
    count = next(iter(counts.values()))
    if t is None:
        frames = np.zeros(1, dtype=np.int64) if count == 1 else truth["t"].values
    else:
        frames = np.atleast_1d(np.asarray(t))
    if len(frames) != count:
        raise ScoreError([Problem("t", f"the arrays hold {count} frames, not these: say which by t=", frames.tolist())])
    x, y = (truth[name].values if name in truth.coords else None for name in ("x", "y"))
    return find_slips(label("estimate", arrays, intrinsics_of(truth), t=frames, x=x, y=y), truth)


def _with_frames(values: ArrayLike, components: int | None, size: tuple[int, ...]) -> NDArray[np.float64] | None:
    """Return an array with its frames, or None if it has another shape, or holds no real numbers."""
    raw = np.asarray(values)
    if raw.dtype.kind not in "fiu" or raw.size == 0:
        return None
    lead = () if components is None else (components,)
    if raw.ndim == len(lead) + 2:
        raw = raw.reshape(*raw.shape[: len(lead)], 1, *raw.shape[len(lead) :])
    if raw.ndim != len(lead) + 3 or raw.shape[: len(lead)] != lead or raw.shape[-2:] != size:
        return None
    return raw.astype(np.float64)


def _slips_of(material: Material) -> list[Slip]:
    quantity = material.quantity
    verdict = likely_slips(material)
    hypothesis = RIGHT if verdict is None else verdict.hypothesis
    shift = fitted_shift(material, hypothesis)
    if verdict is None:
        return [] if shift is None else shift.slips(quantity)
    if hypothesis.parts == 1 and hypothesis.move is not None:
        # Of a surface that moves by a pixel per frame, one frame off looks nearly as one pixel off.
        alone = fitted_shift(material, RIGHT)
        if alone is not None and alone.is_slip and shift is not None and alone.left < shift.left:
            return alone.slips(quantity)
    return hypothesis.slips(quantity, verdict.explained) + ([] if shift is None else shift.slips(quantity))
