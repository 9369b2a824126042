"""Export of a recording as image files."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["is_image_name", "write_images"]

_NAME = re.compile(r"(r[+-]\d+_)?s[+-]\d+_t[+-]\d+\.(png|tiff)")


def is_image_name(name: str) -> bool:
    """Return whether a file name matches the pattern used by `write_images`."""
    return _NAME.fullmatch(name) is not None


def write_images(recording: xr.Dataset, folder: str | Path, form: Literal["png", "tiff"]) -> None:
    """Write each image of a recording to ``s+0_t+0.png``, or to ``r+0_s+0_t+0.png`` in row ``s_y`` = 0 of a grid.

    Invalid pixels are 0 in PNG files, and NaN in TIFF files.
    """
    import imageio.v3 as imageio

    folder = Path(folder)
    folder.mkdir(parents=True)
    full_scale = float(recording.attrs["full_scale"])
    images = recording["image"]
    leading = [dim for dim in ("s_y", "s", "t") if dim in images.dims]
    for index in product(*(recording[dim].values for dim in leading)):
        at = dict(zip(leading, index, strict=True))
        image = images.sel(at).values.astype(np.float64) / full_scale
        if form == "png":
            values: NDArray[Any] = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 65535).astype(np.uint16)
        else:
            values = image.astype(np.float32)
        name = "_".join(f"{'r' if dim == 's_y' else dim}{number:+d}" for dim, number in at.items())
        layout = _describe_layout(values) if form == "tiff" else {}
        imageio.imwrite(folder / f"{name}.{form}", values, **layout)


def _describe_layout(values: NDArray[Any]) -> dict[str, str]:
    """Return how an image is stored in a TIFF file, which versions of tifffile conclude differently from its shape."""
    if values.ndim == 2:
        return {"photometric": "minisblack"}
    return {"photometric": "rgb" if values.shape[-1] == 3 else "minisblack", "planarconfig": "contig"}
