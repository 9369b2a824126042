"""Arrays of results in one order, components, frames, rows, columns; or what their shape may be due to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["arranged", "type_problem"]


def type_problem(values: NDArray[Any], name: str) -> str:
    """Return what is wrong with the type of an array; empty if nothing is.

    Examples
    --------
    >>> type_problem(np.zeros(3, dtype=np.uint16), "depth")
    'holds integers (uint16): write float32 in the units of the quantity, NaN where nothing is known'
    """
    kind = values.dtype.kind
    if kind == "c":
        return f"holds complex numbers ({values.dtype}): write float32"
    if kind not in "fiub":
        return f"holds no numbers ({values.dtype}): write float32"
    if name == "kind":
        if kind == "b" or not np.isin(values, (0, 1, 2)).all():
            return "must hold 0 (none), 1 (normal) or 2 (full), as uint8"
    elif kind != "f":
        what = "booleans" if kind == "b" else "integers"
        return f"holds {what} ({values.dtype}): write float32 in the units of the quantity, NaN where nothing is known"
    return ""


def arranged(values: NDArray[Any], components: int, size: tuple[int, int]) -> NDArray[np.float64]:
    """Return an array as (component, t, y, x).

    Parameters
    ----------
    values
        Of shape (t, y, x) or (y, x); of several components (c, t, y, x) or (c, y, x), or with c last.
    components
        How many there are.
    size
        Height and width of the images.

    Raises
    ------
    ValueError
        If it has another shape; says what may be the reason.

    Examples
    --------
    >>> arranged(np.zeros((30, 40, 2)), 2, (30, 40)).shape
    (2, 1, 30, 40)
    >>> arranged(np.zeros((40, 30)), 1, (30, 40))
    Traceback (most recent call last):
    ValueError: has the shape (40, 30), not (30, 40) or (t, 30, 40): it looks transposed: (x, y)
    """
    shape = values.shape
    if values.size == 0:
        msg = f"is empty: its shape is {shape}"
        raise ValueError(msg)
    if components == 1:
        if values.ndim in (2, 3) and shape[-2:] == size:
            return np.array(values, dtype=np.float64).reshape(1, -1, *size)
    elif values.ndim in (3, 4):
        if shape[0] == components and shape[-2:] == size:
            return np.array(values, dtype=np.float64).reshape(components, -1, *size)
        if shape[-1] == components and shape[-3:-1] == size:
            return np.array(np.moveaxis(values, -1, 0), dtype=np.float64).reshape(components, -1, *size)
    height, width = size
    lead = "" if components == 1 else f"{components}, "
    hint = _hint(shape, components, size)
    msg = f"has the shape {shape}, not ({lead}{height}, {width}) or ({lead}t, {height}, {width})"
    raise ValueError(msg + (f": {hint}" if hint else ""))


def _hint(shape: tuple[int, ...], components: int, size: tuple[int, int]) -> str:
    """Return what a wrong shape may be due to."""
    if len(shape) < 2:
        return ""
    last = components > 1 and shape[0] != components and shape[-1] == components and len(shape) > 2
    found = shape[-3:-1] if last else shape[-2:]
    if found == size:
        if components > 1 and len(shape) == 4 and shape[1] == components:
            return "components come before frames"
        return f"it needs {components} components" if components > 1 else "there is one value for each pixel"
    if found == size[::-1]:
        return "it looks transposed: (x, y)"
    gaps = {had - has for had, has in zip(found, size, strict=True)}
    if gaps <= {0, 1} or gaps <= {0, -1}:
        much = "large" if 1 in gaps else "small"
        return f"it is one pixel too {much}: a half-pixel grid? There is one value for the centre of every pixel"
    for times in (2, 4, 8):
        if found == tuple(-(-length // times) for length in size) or found == tuple(n // times for n in size):
            return f"it seems to hold every {times}{'nd' if times == 2 else 'th'} pixel only"
    return ""
