"""Statistics of the errors of strain: against the exact strain of every pixel, and in the same windows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from scenetruth.errors import Problem, ScoreError
from scenetruth.number_format import format_two_digits
from scenetruth.results import QuantityValue, Result, refuse_unknown
from scenetruth.schema import check_same_run, read_intrinsics
from scenetruth.scoring.alignment import align
from scenetruth.scoring.error_pairs import find_valid_pixels, percent_per_hour
from scenetruth.scoring.regions import main_regions
from scenetruth.scoring.statistics import STATISTICS, error_statistics
from scenetruth.strain.computation import compute_strain, reference_view
from scenetruth.strain.gauge import StrainSettings, strain_settings
from scenetruth.strain.true_strain import compute_true_strain

if TYPE_CHECKING:
    import pandas as pd

    from scenetruth.scene import SceneLike

__all__ = ["StrainScore", "score_strain"]

_SCORED = ("exx", "eyy", "exy", "e1", "e2")
_WINDOWED = "_windowed"
_UNITLESS = frozenset({"relative_rmse", "rms_z", "coverage_2_std", "density", "count"})


@dataclass(frozen=True, repr=False)
class StrainScore(Result):
    """Statistics of the errors of strain.

    Parameters
    ----------
    regions
        Mapping of region (``all``, ``interior``) to quantity to statistic to value; None where undefined. Quantities
        are ``exx``, ``eyy``, ``exy``, ``e1`` and ``e2`` against the exact strain of the pixel, if it is available, and
        with ``_windowed`` against the true motion in the same windows, which excludes the bias of the window.
    units
        Unit of the strains: ``1``, or ``%/h`` of rates.
    metadata
        Measure, settings and gauge.

    See Also
    --------
    score_strain : Compute it.

    Examples
    --------
    >>> errors = {"exx": {"bias": 1e-4, "rmse": 2e-4, "count": 900}}
    >>> found = StrainScore({"all": errors, "interior": errors}, "1", {"measure": "hencky", "gauge_length_px": 61.0})
    >>> found
    StrainScore(hencky: gauge 61 px; RMSE in the interior: exx 0.0002)
    >>> found.value("exx", "bias")
    QuantityValue(0.0001 1, bias, interior, n=900)
    """

    regions: Mapping[str, Mapping[str, Mapping[str, float | None]]]
    units: str
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"StrainScore({self.summary()})"

    def value(self, quantity: str, statistic: str = "rmse", *, region: str = "interior") -> QuantityValue:
        """Return a statistic of a quantity in a region; an ArgumentError lists the choices."""
        refuse_unknown(region=(region, self.regions), quantity=(quantity, self.regions["all"]))
        values = self.regions[region][quantity]
        refuse_unknown(statistic=(statistic, values))
        number, count = values[statistic], values["count"]
        unit = "1" if statistic in _UNITLESS else self.units
        return QuantityValue(
            math.nan if number is None else float(number),
            unit,
            statistic=statistic,
            region=region,
            n=None if count is None else int(count),
        )

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row for each region and quantity, with all statistics."""
        import pandas as pd

        rows = [
            {"region": region, "quantity": quantity, "units": self.units, **values}
            for region, quantities in self.regions.items()
            for quantity, values in quantities.items()
        ]
        return pd.DataFrame(rows, columns=["region", "quantity", "units", *STATISTICS])

    def summary(self) -> str:
        """Return one line with the gauge and the errors in the interior."""
        interior = self.regions["interior"]
        errors = [f"{name} {_short(values['rmse'])}" for name, values in interior.items()]
        unit = "" if self.units == "1" else f" {self.units}"
        gauge = self.metadata.get("gauge_length_px")
        length = "" if gauge is None else f"gauge {gauge:.4g} px; "
        return f"{self.metadata.get('measure')}: {length}RMSE in the interior: {', '.join(errors)}{unit}"


def _short(value: float | None) -> str:
    return "undefined" if value is None else f"{format_two_digits(value)}"


def score_strain(
    estimate: xr.Dataset,
    truth: xr.Dataset,
    scene: SceneLike | None = None,
    *,
    settings: StrainSettings | Mapping[str, Any] | None = None,
    since: int | None = None,
    margin_px: float = 20.0,
    allow_mismatch: bool = False,
) -> StrainScore:
    """Compute strain from an estimate and from its truth, and return the statistics of the errors.

    Parameters
    ----------
    estimate
        An estimate with depth and velocity.
    truth
        Its truth.
    scene
        The scene; required to compare strains with the exact strain of every pixel. Rates are compared with it if the
        truth is complete.
    settings
        As for `compute_strain`.
    since
        As for `compute_strain`: the frame of the reference configuration of all frames.
    margin_px
        Minimum distance of the region ``interior`` from silhouettes and creases, px.
    allow_mismatch
        Whether estimate and truth may belong to different runs.

    Returns
    -------
    StrainScore
        Errors of strain, of rates in %/h. ``rms_z`` and ``coverage_2_std`` compare them with the stated standard
        deviations.

    Raises
    ------
    ScoreError
        If the data sets cannot be compared, or if settings are invalid.
    MismatchError
        If they belong to different runs.
    SceneError
        If the scene is invalid.

    See Also
    --------
    compute_strain : Strain of an estimate or a truth.
    score : Statistics of the errors of depth, motion and growth.

    Examples
    --------
    >>> import numpy as np
    >>> from scenetruth.schema import Intrinsics, label
    >>> camera = Intrinsics(focal_length_px=500.0, principal_point_px=(31.5, 23.5), baseline_mm=5.0)
    >>> one = np.ones((1, 48, 64))
    >>> stretch = np.stack([1e-3 * (np.arange(64) - 31.5) * one, 0 * one, 0 * one])
    >>> maps = {"depth": 500 * one, "disparity": 5 * one, "velocity": stretch, "flow": stretch[:2], "mixed": one == 0}
    >>> truth = label("truth", maps, camera, t=[0])
    >>> estimate = label("estimate", {"depth": 500 * one, "velocity": 1.1 * stretch}, camera, t=[0])
    >>> found = score_strain(estimate, truth, settings={"window": 5, "step": 2, "measure": "engineering"})
    >>> found.value("exx_windowed", "bias")
    QuantityValue(0.0001001 1, bias, interior, n=756)
    """
    chosen = strain_settings(settings)
    wrong = [
        Problem(name, "must be an xarray.Dataset", type(part).__name__)
        for name, part in (("estimate", estimate), ("truth", truth))
        if not isinstance(part, xr.Dataset)
    ]
    if not (isinstance(margin_px, int | float) and math.isfinite(margin_px) and margin_px >= 0):
        wrong.append(Problem("margin_px", "must be a finite number, not negative", margin_px))
    if wrong:
        raise ScoreError(wrong)
    if not allow_mismatch:
        check_same_run({"truth": truth.attrs, "estimate": estimate.attrs})
    found = compute_strain(estimate, settings=chosen, since=since)
    given, exact = align(estimate, truth)
    used = find_valid_pixels(given, "velocity")
    used &= np.isfinite(given["depth"].values) & np.isfinite(given["velocity"].values).all(axis=0)
    motion = [name for name in ("velocity", "displacement_next") if name in exact]
    masked = exact.assign({name: exact[name].where(xr.DataArray(used, dims=("t", "y", "x"))) for name in motion})
    windowed = compute_strain(masked, settings=chosen, since=since)
    at = {dim: found[dim].values for dim in ("t", "y", "x")}
    pixels = _exact(exact, scene, chosen, since)
    factor = percent_per_hour(read_intrinsics(found)) if chosen.measure == "rate" else 1.0
    view = reference_view(exact)
    masks = main_regions(exact, margin_px)
    if since is not None:
        home = int(np.flatnonzero(view["t"].values == since)[0])
        # In the reference frame itself there is no strain, and no error.
        others = (view["t"].values != since)[:, None, None]
        masks = {name: mask[home] & others for name, mask in masks.items()}
    places = {dim: view[dim] for dim in ("t", "y", "x")}
    regions = {
        name: xr.DataArray(mask, dims=("t", "y", "x"), coords=places).sel(at).values for name, mask in masks.items()
    }
    compared = [("", None if pixels is None else pixels.sel(at)), (_WINDOWED, windowed)]
    statistics = {
        region: {
            f"{name}{ending}": error_statistics(
                factor * found[name].values,
                factor * true[name].values,
                mask,
                found["valid"].values,
                factor * found[f"{name}_std"].values if f"{name}_std" in found else None,
            )
            for ending, true in compared
            if true is not None
            for name in _SCORED
        }
        for region, mask in regions.items()
    }
    names = ("measure", "window", "step", "order", "weights", "step_px", "subset_px", "gauge_length_px")
    stated = {name: found.attrs[name] for name in (*names, "gauge_length_mm") if name in found.attrs}
    stated |= {} if since is None else {"since": int(since)}
    stated |= {"margin_px": float(margin_px), "method": str(estimate.attrs.get("method", "external"))}
    return StrainScore(statistics, "%/h" if chosen.measure == "rate" else "1", stated)


def _exact(truth: xr.Dataset, scene: SceneLike | None, chosen: StrainSettings, since: int | None) -> xr.Dataset | None:
    """Return the exact strain of all pixels; None if it cannot be computed."""
    if chosen.measure == "rate":
        return compute_true_strain(truth, settings=chosen) if "principal_growth_rates" in truth else None
    if scene is None:
        return None
    if since is None:
        return compute_true_strain(truth, scene, settings=chosen)
    frames = truth["t"].values
    found = compute_true_strain(truth.sel(t=[since] * len(frames)), scene, settings=chosen, times=frames.tolist())
    return found.assign_coords(t=frames)
