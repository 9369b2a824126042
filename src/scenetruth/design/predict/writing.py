"""A prediction in a folder: its table, and pictures of its maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scenetruth.design.predict.prediction import Prediction
from scenetruth.placing import claim_folder, write_aside

__all__ = ["write"]

_TABLE, _PICTURE = "prediction.csv", "prediction.png"
_COLUMNS = 3
# Of the values of a map, the share below which colours tell them apart: edges are far beyond.
_MOST = 0.95
_SHOWN = ("depth", "slope", "velocity", "growth_rate", "growth_principal", "flow")
_S_PER_H = 3600.0


def write(prediction: Prediction, folder: Path, *, overwrite: bool = False) -> list[str]:
    """Write a prediction.

    Parameters
    ----------
    prediction
        The prediction.
    folder
        Folder to make.
    overwrite
        Whether a prediction that is there is replaced.

    Returns
    -------
    list of str
        Names of the files: the table, and of the level ``"bound"`` a picture of the maps.

    Raises
    ------
    OutputExistsError
        If the folder exists.
    """
    names = [_TABLE]
    with write_aside(folder, overwrite=overwrite, claim=claim_folder(_TABLE)) as aside:
        aside.mkdir()
        prediction.to_frame().to_csv(aside / _TABLE, index=False)
        if prediction.maps is not None:
            _draw(prediction, aside / _PICTURE)
            names.append(_PICTURE)
    return names


def _draw(prediction: Prediction, file: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = _panels(prediction)
    down = -(-len(panels) // _COLUMNS)
    height, width = next(iter(panels.values())).shape
    figure = Figure(figsize=(4.2 * _COLUMNS, (3.6 * height / width + 0.4) * down), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(down, _COLUMNS)).ravel()
    for axis, (title, values) in zip(axes, panels.items(), strict=False):
        known = values[np.isfinite(values)]
        most = float(np.quantile(known, _MOST)) if known.size else 1.0
        shown: Any = axis.imshow(values, cmap="viridis", vmin=0.0, vmax=most)
        axis.set_title(title, fontsize=10)
        axis.set_xticks([])
        axis.set_yticks([])
        figure.colorbar(shown, ax=axis, shrink=0.85, extend="max")
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    figure.suptitle(f"predicted standard deviation per pixel, {prediction.method.replace('_', ' ')}")
    figure.savefig(file, dpi=110)


def _panels(prediction: Prediction) -> dict[str, Any]:
    """Return what is drawn: maps by their titles."""
    maps = prediction.maps
    assert maps is not None
    per_hour = 100.0 * _S_PER_H / prediction.frame_interval_s
    found: dict[str, Any] = {}
    for name in _SHOWN:
        if f"{name}_std" not in maps or (name == "flow" and "velocity_std" in maps):
            continue
        one = maps[f"{name}_std"]
        words, unit = name.replace("_rate", "").replace("_", " "), one.attrs["units"]
        if unit == "1/frame":
            one, unit = per_hour * one, "%/h"
        lead = [dim for dim in one.dims if dim not in ("y", "x")]
        if lead:
            for label in one[lead[0]].values.tolist():
                shown = "" if unit == "1" else f", {unit}"
                found[f"{words} {label}{shown}"] = one.sel({lead[0]: label}).values
        else:
            found[f"{words}, {unit}"] = one.values
    return found
