"""Result of a prediction: standard deviations by region and quantity, their inputs, table and maps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from scenetruth.output import claim_folder, write_atomically
from scenetruth.results import QuantityValue, Result, refuse_unknown

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = ["TITLES", "UNITS", "Model", "PredictedValue", "Prediction", "PredictionInputs", "write_prediction"]


UNITS: Mapping[str, str] = {
    "depth": "mm",
    "disparity": "px/step",
    "velocity_x": "mm/frame",
    "velocity_y": "mm/frame",
    "velocity_z": "mm/frame",
    "flow_x": "px/frame",
    "flow_y": "px/frame",
    "velocity_epe": "mm/frame",
    "growth_rate": "%/h",
    "growth_principal_1": "%/h",
    "growth_principal_2": "%/h",
    "slope_x": "1",
    "slope_y": "1",
    "normal": "°",
}
"""Display units by quantity; data sets have growth per frame."""

TITLES: Mapping[str, str] = {
    "depth": "Depth",
    "disparity": "Disparity",
    "velocity_x": "Velocity in X",
    "velocity_y": "Velocity in Y",
    "velocity_z": "Velocity in Z",
    "flow_x": "Optical flow in x",
    "flow_y": "Optical flow in y",
    "velocity_epe": "Velocity endpoint",
    "growth_rate": "Growth rate",
    "growth_principal_1": "Largest principal growth rate",
    "growth_principal_2": "Smallest principal growth rate",
    "slope_x": "Slope in X",
    "slope_y": "Slope in Y",
    "normal": "Normal",
}
"""Titles by quantity."""


Model = Literal["analytic", "maps"]
_S_PER_H = 3600.0
_UNITS_INSIDE = {"%/h": "1/frame"}


@dataclass(frozen=True)
class PredictedValue:
    """Predicted standard deviation of a quantity in a region.

    Parameters
    ----------
    std
        Median of the predicted standard deviation over the region; infinite where it is undetermined.
    unit
        Unit of ``std`` and ``signal``, as in data sets (growth per frame).
    signal
        RMS of the true motion or growth over the region; None for other quantities.
    value, signal_value, value_unit
        ``std`` and ``signal`` in display units, with growth in %/h.
    valid_fraction
        Fraction of the region where the standard deviation is determined.
    rmse, p95_abs_error
        Root mean square of the standard deviation over the region, and 95th percentile of the absolute values of normal
        errors with these standard deviations; in ``value_unit``, infinite where undetermined.

    See Also
    --------
    Prediction : Contains a value for each region and quantity.

    Examples
    --------
    A sheet that grows by 2 % per hour, recorded every ten minutes:

    >>> import scenetruth as st
    >>> sheet = {"name": "sheet", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 600]}}
    >>> sheet |= {"texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    >>> sheet |= {"deformation": [{"kind": "growth", "rate_per_hour": 0.02}]}
    >>> plain = {"camera": {"width": 160, "height": 120, "focal_length_px": 2000}, "objects": [sheet]}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "frames": {"count": 5, "frame_interval_s": 600}}
    >>> prediction = st.predict(plain | {"sensor": {"noise_std": 0.01}}, method="refined")
    >>> figure = prediction.precision("growth_rate", "object_sheet")
    >>> f"{figure.signal_value:.2f} {figure.value_unit}, standard deviation {figure.value:.2f} per pixel"
    '2.00 %/h, standard deviation 0.21 per pixel'
    >>> f"{figure.signal:.5f} {figure.unit}, {figure.signal_to_noise:.0f} standard deviations"
    '0.00333 1/frame, 10 standard deviations'
    """

    std: float
    unit: str
    signal: float | None
    value: float
    signal_value: float | None
    value_unit: str
    valid_fraction: float
    rmse: float = float("inf")
    p95_abs_error: float = float("inf")

    @property
    def signal_to_noise(self) -> float | None:
        """Ratio of the signal to the standard deviation; None for quantities without a signal."""
        if self.signal is None:
            return None
        return self.signal / self.std if self.std > 0 else float("inf")


@dataclass(frozen=True)
class PredictionInputs:
    """Inputs of a prediction: medians over a region unless stated otherwise.

    Parameters
    ----------
    noise_std
        Standard deviation of temporal noise in an image, relative to full scale, including rounding.
    pattern_std
        Standard deviation of fixed-pattern noise, relative to full scale.
    grey_level
        Mean grey value, relative to full scale.
    white_level
        Grey value of the brightest possible texture in the same light, relative to full scale.
    contrast
        Standard deviation of the texture in the images, relative to full scale.
    gradient_x, gradient_y
        RMS derivatives of the texture, relative to full scale, per px.
    transfer
        Fraction of the texture contrast that remains after blur by lens, pixels and motion.
    wavelength_px
        RMS mean wavelength of the texture in the images, in px: 2π contrast / length of the gradient.
    disparity_px, depth_mm
        Disparity in px per step, and depth in mm.
    flow_px
        Magnitude of the optical flow, px per frame.
    blur_px
        95th percentile of the motion during the exposure over all moving points, px; 0 without motion.
    window_sigma_px, motion
        Standard deviation of the window, and motion model of the method.
    positions, frames
        Number of cameras, and of frames that are estimated together.

    See Also
    --------
    Prediction : Contains the inputs as ``causes``, and by region as ``by_region``.
    recommend : Recommends changes.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 600]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    >>> plain = {"camera": {"width": 160, "height": 120, "focal_length_px": 2000}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "frames": {"count": 5}, "sensor": {"noise_std": 0.01}}
    >>> causes = st.predict(plain, method="refined").causes
    >>> f"{causes.disparity_px:.1f} px per step at {causes.depth_mm:.0f} mm, waves of {causes.wavelength_px:.1f} px"
    '16.7 px per step at 600 mm, waves of 9.2 px'
    >>> f"gradients of {causes.gradient_x:.3f} per px, noise of {causes.noise_std:.3f}"
    'gradients of 0.059 per px, noise of 0.010'
    >>> f"brightest grey values at {100 * causes.brightest_level:.0f} % of full scale"
    'brightest grey values at 87 % of full scale'
    """

    noise_std: float
    pattern_std: float
    grey_level: float
    white_level: float
    contrast: float
    gradient_x: float
    gradient_y: float
    transfer: float
    wavelength_px: float
    disparity_px: float
    depth_mm: float
    flow_px: float
    blur_px: float
    window_sigma_px: float
    motion: str
    positions: int
    frames: int

    @property
    def brightest_level(self) -> float:
        """Brightest grey values, relative to full scale: three standard deviations above the mean, at most white level.

        Above 1, images are saturated.
        """
        return min(self.grey_level + 3 * self.contrast, self.white_level)


@dataclass(frozen=True, eq=False)
class Prediction(Result):
    """Predicted standard deviations of depth, motion, slopes and growth of a scene.

    Parameters
    ----------
    model
        ``"analytic"``: from geometry and texture spectrum; ``"maps"``: from a noise-free image.
    method
        Estimation method.
    regions
        ``"all"``, ``"interior"``, and ``"object_NAME"`` for every visible object: its interior, or the whole object if
        it has no interior.
    frame_interval_s
        Time between two frames.
    precisions
        Predicted standard deviations by region and quantity.
    by_region
        Inputs by region.
    maps
        Maps of the standard deviations, ``depth_std`` and so on as in `cramer_rao_bound`; None with ``analytic``, and
        after `load`: `save` leaves them out.
    notes
        Effects that are not included.
    pattern_cost
        Factor by which fixed-pattern noise increases the standard deviation, by quantity; missing quantities are not
        affected. The predicted values include it.
    growth_bias_share
        Share of the bias of isotropic growth in the predicted variance of the growth rate, by region; none if growth is
        isotropic or the affine motion model is used. The predicted values include it.

    See Also
    --------
    predict : Computes a prediction.
    recommend : Returns recommendations.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [90, 90]}, "pose": {"position_mm": [0, 0, 600]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [2, 8]}}
    >>> plain = {"camera": {"width": 160, "height": 120, "focal_length_px": 2000}, "objects": [wall]}
    >>> plain |= {"stage": {"positions": 5, "baseline_mm": 5}, "frames": {"count": 5}, "sensor": {"noise_std": 0.01}}
    >>> prediction = st.predict(plain, method="refined")
    >>> prediction.method, prediction.regions
    ('refined', ('all', 'interior', 'object_wall'))
    >>> for quantity in ("depth", "velocity_x", "velocity_z"):
    ...     figure = prediction.precision(quantity, "interior")
    ...     print(f"{quantity}: {figure.value:.1g} {figure.value_unit}")
    depth: 0.05 mm
    velocity_x: 0.0008 mm/frame
    velocity_z: 0.03 mm/frame
    >>> prediction.to_dataframe().columns[:5].tolist()
    ['region', 'quantity', 'std', 'unit', 'signal']
    """

    model: Model
    method: str
    regions: tuple[str, ...]
    frame_interval_s: float
    precisions: Mapping[str, Mapping[str, PredictedValue]]
    by_region: Mapping[str, PredictionInputs]
    maps: xr.Dataset | None = None
    notes: tuple[str, ...] = field(default=())
    pattern_cost: Mapping[str, float] = field(default_factory=dict)
    growth_bias_share: Mapping[str, float] = field(default_factory=dict)

    @property
    def causes(self) -> PredictionInputs:
        """Inputs of the prediction: medians over the visible surface."""
        return self.by_region["all"]

    @property
    def quantities(self) -> tuple[str, ...]:
        """Predicted quantities: keys of `scenetruth.scoring.QUANTITIES`."""
        return tuple(self.precisions["all"])

    def precision(self, quantity: str, region: str = "interior") -> PredictedValue:
        """Return the predicted standard deviation of a quantity in a region, with all that belongs to it.

        Parameters
        ----------
        quantity
            One of `quantities`.
        region
            One of `regions`.

        Raises
        ------
        ArgumentError
            If one of them is not predicted; the message lists those that are.
        """
        refuse_unknown(region=(region, self.regions), quantity=(quantity, self.quantities))
        return self.precisions[region][quantity]

    def value(self, quantity: str, statistic: str = "rmse", *, region: str = "interior") -> QuantityValue:
        """Return a statistic of the errors that the predicted standard deviations lead to.

        Parameters
        ----------
        quantity
            One of `quantities`.
        statistic
            ``rmse``: root mean square of the standard deviations over the region; ``scaled_median_abs_error``: their
            median; ``p95_abs_error``: 95th percentile of the absolute values of normal errors.
        region
            One of `regions`.

        Raises
        ------
        ArgumentError
            If one of them is not predicted; the message lists those that are.
        """
        one = self.precision(quantity, region)
        values = {"rmse": one.rmse, "scaled_median_abs_error": one.value, "p95_abs_error": one.p95_abs_error}
        refuse_unknown(statistic=(statistic, values))
        return QuantityValue(values[statistic], one.value_unit, statistic=statistic, region=region)

    def summary(self) -> str:
        """Return the RMSE of every quantity in the interior, then the notes, one per line."""
        values = [
            (name, self.value(name, region=self.regions[min(1, len(self.regions) - 1)])) for name in self.quantities
        ]
        lines = [f"{TITLES[name]}: RMSE {one.value:.3g} {one.unit} ({one.region})" for name, one in values]
        return "\n".join([f"{self.method.replace('_', ' ')}, model {self.model}", *lines, *self.notes])

    _UNSAVED = frozenset({"maps"})

    @classmethod
    def _names(cls) -> dict[str, Any]:
        import xarray

        return {"xr": xarray}

    def to_dataframe(self) -> pd.DataFrame:
        """Return a table with one row per value: region, quantity, all fields of `PredictedValue`, model, method."""
        import pandas as pd

        rows: list[dict[str, Any]] = [
            {"region": region, "quantity": quantity, **vars(figure), "model": self.model, "method": self.method}
            for region in self.regions
            for quantity, figure in self.precisions[region].items()
        ]
        return pd.DataFrame(rows)


def compute_value(
    quantity: str,
    spread: tuple[float, float, float],
    signal: float | None,
    valid_fraction: float,
    frame_interval_s: float,
) -> PredictedValue:
    """Return a predicted value with its display units."""
    unit = UNITS[quantity]
    factor = 100.0 * _S_PER_H / frame_interval_s if unit in _UNITS_INSIDE else 1.0
    entries = None if signal is None else factor * signal
    std, rms, percentile = spread
    inside = _UNITS_INSIDE.get(unit, unit)
    return PredictedValue(
        std, inside, signal, factor * std, entries, unit, valid_fraction, factor * rms, factor * percentile
    )


_TABLE, _PICTURE = "prediction.csv", "prediction.png"
_COLUMNS = 3
_MOST = 0.95  # quantile of the values of a map at the end of the colour scale: values at edges are far larger
_SHOWN = ("depth", "slope", "velocity", "growth_rate", "principal_growth_rates", "flow")


def write_prediction(prediction: Prediction, folder: Path, *, overwrite: bool = False) -> list[str]:
    """Write the table of a prediction and, if present, a figure of its maps."""
    names = [_TABLE]
    with write_atomically(folder, overwrite=overwrite, claim=claim_folder(_TABLE)) as partial:
        partial.mkdir()
        prediction.to_dataframe().to_csv(partial / _TABLE, index=False)
        if prediction.maps is not None:
            _draw(prediction, partial / _PICTURE)
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
    """Return the maps to draw, by title."""
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
