"""Colour filter arrays: mosaicing, and demosaicing by bilinear, binomial or gradient-corrected interpolation."""

from __future__ import annotations

from typing import Any, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

__all__ = ["DEMOSAICING_KERNELS", "DemosaicingMethod", "demosaic", "demosaicing_taps", "filter_colours", "mosaic"]

DemosaicingMethod = Literal["bilinear", "malvar", "binomial"]
"""Bilinear interpolation, the gradient-corrected linear interpolation of Malvar, He and Cutler (2004), or bilinear
interpolation and a binomial filter.
"""

_Number = TypeVar("_Number", bound=np.generic)
_Taps = dict[tuple[int, int], float]

_COLOURS = "rgb"
_RED, _GREEN, _BLUE = range(3)
_IDENTITY: _Taps = {(0, 0): 1.0}
_PATTERNS = ("rggb", "grbg", "gbrg", "bggr")
_REACH = 2
_BINOMIAL = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)


def _symmetric_taps(*groups: tuple[float, tuple[tuple[int, int], ...]]) -> _Taps:
    """Return the weights of a kernel that is symmetric about its centre, from groups of offsets (y, x) in pixels."""
    taps: _Taps = {}
    for weight, offsets in groups:
        for y, x in offsets:
            taps[y, x] = taps[-y, -x] = weight
    return taps


_CENTRE = ((0, 0),)
_ROW, _COLUMN = ((0, 1),), ((1, 0),)
_FAR_ROW, _FAR_COLUMN = ((0, 2),), ((2, 0),)
_CROSS = (*_ROW, *_COLUMN)
_FAR_CROSS = (*_FAR_ROW, *_FAR_COLUMN)
_DIAGONALS = ((1, 1), (1, -1))

DEMOSAICING_KERNELS: dict[str, dict[str, _Taps]] = {
    "bilinear": {
        "cross": _symmetric_taps((1 / 4, _CROSS)),
        "row": _symmetric_taps((1 / 2, _ROW)),
        "column": _symmetric_taps((1 / 2, _COLUMN)),
        "diagonal": _symmetric_taps((1 / 4, _DIAGONALS)),
    },
    # Eighths of the coefficients in figure 2 of the paper.
    "malvar": {
        "cross": _symmetric_taps((4 / 8, _CENTRE), (2 / 8, _CROSS), (-1 / 8, _FAR_CROSS)),
        "row": _symmetric_taps(
            (5 / 8, _CENTRE), (4 / 8, _ROW), (-1 / 8, (*_DIAGONALS, *_FAR_ROW)), (0.5 / 8, _FAR_COLUMN)
        ),
        "column": _symmetric_taps(
            (5 / 8, _CENTRE), (4 / 8, _COLUMN), (-1 / 8, (*_DIAGONALS, *_FAR_COLUMN)), (0.5 / 8, _FAR_ROW)
        ),
        "diagonal": _symmetric_taps((6 / 8, _CENTRE), (2 / 8, _DIAGONALS), (-1.5 / 8, _FAR_CROSS)),
    },
}
"""Weights by interpolation and by the neighbours of the missing colour, as a mapping of offsets (y, x) in pixels.

``cross`` is green at red and blue pixels, ``row`` and ``column`` are red and blue at green pixels, and ``diagonal`` is
blue at red pixels or red at blue pixels.
"""


def filter_colours(pattern: str) -> NDArray[np.int64]:
    """Return the colours of the 2 x 2 pixels of a pattern, 0 for red, 1 for green, 2 for blue.

    >>> filter_colours("GRBG")
    array([[1, 0],
           [2, 1]])
    """
    if pattern.lower() not in _PATTERNS:
        msg = f"pattern: must be one of {', '.join(name.upper() for name in _PATTERNS)}; got {pattern!r}"
        raise ValueError(msg)
    return np.array([_COLOURS.index(colour) for colour in pattern.lower()]).reshape(2, 2)


def demosaicing_taps(
    pattern: str, method: DemosaicingMethod
) -> dict[tuple[int, int, int], dict[tuple[int, int, int], float]]:
    """Return the weights of a demosaicing: by pixel of the pattern and colour, those of its neighbours.

    Keys are row and column of the pixel and the colour of the result; those of the weights are the offset (y, x) and
    the colour of the neighbour.
    """
    colours = filter_colours(pattern)
    taps = {}
    for y, x in np.ndindex(2, 2):
        for colour in range(3):
            kernel = _kernel_of(colours, y, x, colour)
            weights = DEMOSAICING_KERNELS[_interpolation_of(method)][kernel] if kernel else _IDENTITY
            own = {(dy, dx, int(colours[(y + dy) % 2, (x + dx) % 2])): weight for (dy, dx), weight in weights.items()}
            taps[y, x, colour] = own
    return _filtered_taps(taps) if method == "binomial" else taps


def _interpolation_of(method: DemosaicingMethod) -> str:
    return "bilinear" if method == "binomial" else method


def _filtered_taps(
    taps: dict[tuple[int, int, int], dict[tuple[int, int, int], float]],
) -> dict[tuple[int, int, int], dict[tuple[int, int, int], float]]:
    """Return the weights of a demosaicing that a binomial filter along x and y follows."""
    found: dict[tuple[int, int, int], dict[tuple[int, int, int], float]] = {}
    for y, x, colour in taps:
        total: dict[tuple[int, int, int], float] = {}
        for down, right in np.ndindex(5, 5):
            q, p = down - 2, right - 2
            for (dy, dx, source), weight in taps[(y + q) % 2, (x + p) % 2, colour].items():
                place = dy + q, dx + p, source
                total[place] = total.get(place, 0.0) + _BINOMIAL[down] * _BINOMIAL[right] * weight
        found[y, x, colour] = total
    return found


def mosaic(colour: NDArray[_Number], pattern: str) -> NDArray[_Number]:
    """Sample a colour image through a Bayer filter: one colour per pixel.

    Parameters
    ----------
    colour
        Colour image, shape (y, x, 3): red, green, blue.
    pattern
        Colours of the 2 x 2 pixels in row-major order from the upper left: RGGB, GRBG, GBRG or BGGR.

    Returns
    -------
    NDArray
        Image of shape (y, x) and unchanged type.

    Raises
    ------
    ValueError
        If the shape or the pattern is not one of these.

    See Also
    --------
    demosaic : Interpolates the missing colours.

    Examples
    --------
    >>> mosaic(np.arange(12).reshape(2, 2, 3), "RGGB")
    array([[ 0,  4],
           [ 7, 11]])
    """
    if colour.ndim != 3 or colour.shape[2] != 3:
        msg = f"colour: must have the shape (y, x, 3); got {colour.shape}"
        raise ValueError(msg)
    colours = filter_colours(pattern)
    samples = np.empty_like(colour, shape=colour.shape[:2])
    for y, x in np.ndindex(2, 2):
        samples[y::2, x::2] = colour[y::2, x::2, colours[y, x]]
    return samples


def demosaic(
    mosaic: NDArray[_Number],
    pattern: str,
    method: DemosaicingMethod = "malvar",
    *,
    full_scale: int | None = None,
) -> NDArray[_Number]:
    """Interpolate the two missing colours of every pixel behind a Bayer filter.

    All methods are linear and reproduce affine functions of position, independent in each colour, exactly. Beyond the
    borders the image is mirrored about its outermost pixels, which continues the pattern.

    Parameters
    ----------
    mosaic
        Image of shape (y, x), at least 2 x 2 pixels: integers or floating-point numbers.
    pattern
        Colours of the 2 x 2 pixels in row-major order from the upper left: RGGB, GRBG, GBRG or BGGR.
    method
        ``"bilinear"``: mean of the nearest pixels of the colour. ``"malvar"``: the same plus a fraction of the
        Laplacian of the colour that the pixel has, 1/2, 5/8 and 3/4. ``"binomial"``: ``"bilinear"`` and a binomial
        filter (1, 4, 6, 4, 1) / 16 along x and y, which removes nearly all of the aliases of waves of 6 px or longer.
    full_scale
        Largest value of integers; default: the largest of the type. Not used for floating-point numbers.

    Returns
    -------
    NDArray
        Colour image of shape (y, x, 3), red, green, blue, of unchanged type. Integers are rounded to the nearest and
        clipped to [0, ``full_scale``]. Floating-point numbers are not clipped: ``"malvar"`` overshoots at edges.

    Raises
    ------
    ValueError
        If the shape, type, pattern or method is not one of these.

    See Also
    --------
    mosaic : The inverse: ``mosaic(demosaic(image, pattern), pattern)`` equals the image, except for ``"binomial"``.

    Notes
    -----
    H. S. Malvar, L.-W. He and R. Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color
    images", ICASSP 2004, https://doi.org/10.1109/ICASSP.2004.1326587.

    Examples
    --------
    >>> demosaic(np.array([[8.0, 4.0], [4.0, 2.0]]), "RGGB", "bilinear")[0, 1]
    array([8., 4., 2.])
    """
    colours = filter_colours(pattern)
    if method not in get_args(DemosaicingMethod):
        msg = f"method: must be one of {', '.join(get_args(DemosaicingMethod))}; got {method!r}"
        raise ValueError(msg)
    if mosaic.ndim != 2 or min(mosaic.shape) < 2:
        msg = f"mosaic: must have the shape (y, x) with at least 2 x 2 pixels; got {mosaic.shape}"
        raise ValueError(msg)
    if mosaic.dtype.kind not in "uif":
        msg = f"mosaic: must be integers or floating-point numbers; got {mosaic.dtype}"
        raise ValueError(msg)

    # Sixteenths of integers are exact: 16 bits and the weights take 21 of the 24 bits of a float32.
    exact = np.float32 if mosaic.dtype.itemsize <= 2 and method != "binomial" else np.float64
    computed: Any = mosaic.dtype if mosaic.dtype.kind == "f" else exact
    padded = np.pad(mosaic, _REACH, mode="reflect").astype(computed, copy=False)
    result = np.empty((*mosaic.shape, 3), computed)
    for y, x in np.ndindex(2, 2):
        for colour in range(3):
            kernel = _kernel_of(colours, y, x, colour)
            taps = DEMOSAICING_KERNELS[_interpolation_of(method)][kernel] if kernel else _IDENTITY
            result[y::2, x::2, colour] = _weighted_sum(padded, y, x, mosaic.shape, taps)
    if method == "binomial":
        result = _filter_binomially(result)
    if mosaic.dtype.kind == "f":
        return result
    integers: Any = mosaic.dtype
    largest = np.iinfo(integers).max if full_scale is None else full_scale
    return np.clip(np.rint(result, out=result), 0, largest, out=result).astype(mosaic.dtype)


def _filter_binomially(colours: NDArray[Any]) -> NDArray[Any]:
    """Return colours of shape (y, x, 3) after a binomial filter along x and y, mirrored at the borders."""
    from scipy.ndimage import convolve1d

    rows = convolve1d(colours, _BINOMIAL, axis=0, mode="mirror")
    return np.asarray(convolve1d(rows, _BINOMIAL, axis=1, mode="mirror"))


def _kernel_of(colours: NDArray[np.int64], y: int, x: int, colour: int) -> str:
    """Return which neighbours of the pixels of a phase have a colour; empty for the pixels themselves."""
    if colours[y, x] == colour:
        return ""
    if colour == _GREEN:
        return "cross"
    if colours[y, x] != _GREEN:
        return "diagonal"
    return "row" if colours[y, 1 - x] == colour else "column"


def _weighted_sum(padded: NDArray[Any], y: int, x: int, shape: tuple[int, ...], taps: _Taps) -> NDArray[Any]:
    """Return the weighted sum of the neighbours of every second pixel; neighbours of equal weight are added first."""
    groups: dict[float, NDArray[Any]] = {}
    for (dy, dx), weight in taps.items():
        rows = slice(_REACH + y + dy, _REACH + shape[0] + dy, 2)
        columns = slice(_REACH + x + dx, _REACH + shape[1] + dx, 2)
        pixels = padded[rows, columns]
        groups[weight] = groups[weight] + pixels if weight in groups else pixels
    total, *others = (group * weight for weight, group in groups.items())
    for other in others:
        total += other
    return total
