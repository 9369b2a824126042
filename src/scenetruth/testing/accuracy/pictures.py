"""Pictures of what broke its limit: estimate, truth and error side by side."""

from __future__ import annotations

from collections.abc import Collection
from itertools import count
from pathlib import Path

import numpy as np
import xarray as xr

from scenetruth.schema import blank_map, intrinsics_of, label
from scenetruth.scoring import QUANTITIES

__all__ = ["draw_differences"]


def draw_differences(
    estimate: xr.Dataset, truth: xr.Dataset, recording: xr.Dataset | None, names: Collection[str], folder: Path
) -> list[Path]:
    """Draw some quantities of one frame, t = 0 or the middle one; a distance as the components of its vector.

    Parameters
    ----------
    estimate, truth, recording
        What was compared, and what was estimated from.
    names
        Keys of `scenetruth.scoring.QUANTITIES`. Angles, and what the estimate does not know, are left out.
    folder
        Where the PNG files go, one for each variable; made if missing. None is overwritten.

    Returns
    -------
    list of pathlib.Path
        The files.
    """
    # matplotlib takes a second to import, and nobody needs it for what is kept.
    from scenetruth.scoring.figures._common import style
    from scenetruth.scoring.figures._comparison import draw_comparison
    from scenetruth.scoring.figures._views import views_of

    views = views_of(_blank_like(estimate) if recording is None else recording, estimate, truth)
    wanted = {part for name in names for part in _scalars(name)}
    # In the order of the table, the components of a vector in one picture.
    known = [name for name in QUANTITIES if name in wanted and name in views.truth and views.knows(name)]
    files = []
    for variable in dict.fromkeys(QUANTITIES[name].variable for name in known):
        shown = tuple(name for name in known if QUANTITIES[name].variable == variable)
        folder.mkdir(parents=True, exist_ok=True)
        file = _free(folder, variable if len(shown) > 1 else shown[0])
        with style():
            draw_comparison(views, shown, file, signed=variable not in ("depth", "disparity"))
        files.append(file)
    return files


def _scalars(name: str) -> tuple[str, ...]:
    entry = QUANTITIES[name]
    if entry.error == "difference":
        return (name,)
    return tuple(
        other
        for other, one in QUANTITIES.items()
        if entry.error == "distance" and one.variable == entry.variable and one.error == "difference"
    )


def _free(folder: Path, stem: str) -> Path:
    names = (folder / f"{stem}{'' if number == 1 else f'_{number}'}.png" for number in count(1))
    return next(file for file in names if not file.exists())


def _blank_like(estimate: xr.Dataset) -> xr.Dataset:
    """Return a recording without a picture, of the pixels of an estimate."""
    x, y = (estimate[name].values if name in estimate.coords else None for name in ("x", "y"))
    image = blank_map(np.float32, (1, 1, estimate.sizes["y"], estimate.sizes["x"]))
    intrinsics = intrinsics_of(estimate)
    return label("recording", {"image": image}, intrinsics, t=[0], s=[0], x=x, y=y, attrs={"full_scale": 1.0})
