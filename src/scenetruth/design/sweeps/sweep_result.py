"""The result of a sweep: records as a tidy table, and the best levels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.design.sweeps.factors import format_level
from scenetruth.errors import ArgumentError, Problem
from scenetruth.results import QuantityValue, Result
from scenetruth.scoring.quantities import get_title

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["STATISTICS", "Sweep", "SweepRecord"]


STATISTICS = ("rmse", "bias", "precision_std", "median_abs_error", "density")
"""Statistics of errors; ``density`` is the fraction of the pixels that are valid."""


@dataclass(frozen=True)
class SweepRecord:
    """One value of a statistic.

    ``values``: Levels by factor.
    ``method``: Label of the method; ``bound`` or ``bound of METHOD`` for the Cramér-Rao bound.
    ``seed``: Seed of the scene; None for all seeds together.
    ``region``: Region of the score: ``all``, ``interior``, ``object_NAME``.
    ``quantity``: A key of `scenetruth.scoring.QUANTITIES`.
    ``ci_low``, ``ci_high``: Ends of the 95 % confidence interval over seeds; NaN if there is none.
    """

    values: Mapping[str, Any]
    scene: str
    method: str
    seed: int | None
    region: str
    quantity: str
    statistic: str
    value: float
    ci_low: float = math.nan
    ci_high: float = math.nan
    unit: str = ""

    @property
    def is_bound(self) -> bool:
        """Whether the value is the Cramér-Rao bound."""
        return self.method.split(" ")[0] == "bound"


_COLUMNS = ("scene", "method", "seed", "region", "quantity", "statistic", "value", "ci_low", "ci_high", "unit")


@dataclass(frozen=True)
class Sweep(Result):
    """Error statistics of methods over the levels of factors.

    Parameters
    ----------
    factors
        Paths of the factors.
    scenes
        Labels of the scenes.
    methods
        Labels of the methods.
    rows
        The records.
    failures
        Messages of failed simulations and methods.
    notes
        Other messages.
    folder
        Output directory; None without one.
    grows
        Whether an object grows; otherwise errors of growth are in the table only.
    is_grid
        Whether the points are a full grid of levels, without Sobol points.
    logarithmic
        Factors with a logarithmic axis for any levels.

    See Also
    --------
    sweep : Run a sweep.

    Examples
    --------
    >>> import scenetruth as st
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2}, "frames": {"count": 1}, "render": {"backend": "raycast"}}
    >>> scene |= {"sensor": {"noise_std": 0.01}, "score": {"interior_margin_px": 0}}
    >>> found = st.sweep(scene, {"stage.baseline_mm": [2, 4]}, methods="structure_tensor", seeds=1)
    >>> row = found.value("depth", at={"stage.baseline_mm": 4})
    >>> f"{row.value:.1f} {row.unit}"
    '0.7 mm'

    All points with the Cramér-Rao bound:

    >>> for row in found.selected("depth", "rmse"):
    ...     print(row.values, row.method, f"{row.value:.1f} {row.unit}")
    {'stage.baseline_mm': 2} structure_tensor 1.4 mm
    {'stage.baseline_mm': 2} bound 1.4 mm
    {'stage.baseline_mm': 4} structure_tensor 0.7 mm
    {'stage.baseline_mm': 4} bound 0.7 mm
    >>> found.to_dataframe().columns[:4].tolist()
    ['stage.baseline_mm', 'scene', 'method', 'seed']
    """

    factors: Sequence[str]
    scenes: Sequence[str]
    methods: Sequence[str]
    rows: Sequence[SweepRecord] = field(repr=False)
    failures: Sequence[str] = field(default=(), repr=False)
    notes: Sequence[str] = field(default=(), repr=False)
    folder: Path | None = None
    grows: bool = False
    is_grid: bool = True
    logarithmic: frozenset[str] = frozenset()

    def to_dataframe(self) -> pd.DataFrame:
        """Return a table with one row per record.

        Returns
        -------
        pandas.DataFrame
            One column per factor with its levels: numbers, or labels of other levels. Then the other fields of
            `scenetruth.design.sweeps.sweep_result.SweepRecord`; ``seed`` is missing for all seeds together.
        """
        import pandas as pd

        columns: dict[str, Any] = {}
        for path in self.factors:
            values = [row.values[path] for row in self.rows]
            numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
            columns[path] = values if numbers else list(map(format_level, values))
        columns |= {name: [getattr(row, name) for row in self.rows] for name in _COLUMNS}
        columns["seed"] = pd.array(columns["seed"], dtype="Int64")
        return pd.DataFrame(columns)

    def value(
        self,
        quantity: str,
        statistic: str = "rmse",
        *,
        region: str = "interior",
        method: str | None = None,
        at: Mapping[str, Any] | None = None,
        scene: str | None = None,
        seed: int | None = None,
    ) -> QuantityValue:
        """Return one statistic at one point of the sweep.

        Parameters
        ----------
        quantity, statistic
            A key of `scenetruth.scoring.QUANTITIES`; ``rmse``, ``bias``, ``precision_std``, ``median_abs_error`` or
            ``density``.
        region, method, scene
            By default the interior, the first method, the first scene.
        at
            Levels of factors, by path; the first point with these levels is taken.
        seed
            A single seed; by default all seeds together.

        Returns
        -------
        QuantityValue
            With the 95 % confidence interval over seeds.

        Raises
        ------
        ArgumentError
            If there is no such record; the message names what was asked for.
        """
        labels = self.methods[:1] if method is None else [method]
        for row in self.selected(quantity, statistic, region=region, methods=labels, scene=scene, seed=seed):
            if all(row.values.get(path, math.nan) == value for path, value in (at or {}).items()):
                return QuantityValue(
                    row.value, row.unit, row.ci_low, row.ci_high, statistic=row.statistic, region=row.region
                )
        point = ", ".join(f"{path} = {format_level(value)}" for path, value in (at or {}).items())
        message = f"there is no {statistic} in region {region} by {method or 'any method'} {point}".rstrip()
        raise ArgumentError([Problem("quantity", message, quantity)])

    def summary(self) -> str:
        """Return the least RMSE of each quantity in the interior, then notes and failures, one per line."""
        lines = []
        for quantity in dict.fromkeys(row.quantity for row in self.rows):
            rows = [row for row in self.selected(quantity, "rmse", methods=self.methods) if math.isfinite(row.value)]
            if rows:
                least = min(rows, key=lambda row: row.value)
                point = ", ".join(f"{path} = {format_level(value)}" for path, value in least.values.items())
                lines.append(
                    f"{get_title(quantity)}: least RMSE {least.value:.3g} {least.unit} by {least.method} at {point}"
                )
        return "\n".join([*lines, *self.notes, *self.failures])

    def best(
        self,
        quantity: str,
        statistic: str = "rmse",
        *,
        region: str = "interior",
        method: str | None = None,
        scene: str | None = None,
    ) -> SweepRecord:
        """Return the record nearest to 0 (the largest for ``density``) over all points, all seeds together.

        Parameters
        ----------
        quantity, statistic, region, scene
            As in `value`; default: all scenes.
        method
            Label of the method; default: all methods.

        Raises
        ------
        ArgumentError
            If there is no such record.
        """
        labels = self.methods if method is None else [method]
        rows = list(self.selected(quantity, statistic, region=region, methods=labels, scene=scene))
        if not rows:
            raise ArgumentError([Problem("quantity", f"there is no {statistic} in region {region}", quantity)])
        if statistic == "density":
            return max(rows, key=lambda row: row.value)
        return min(rows, key=lambda row: abs(row.value))

    def selected(
        self,
        quantity: str,
        statistic: str,
        *,
        region: str = "interior",
        methods: Iterable[str] | None = None,
        scene: str | None = None,
        seed: int | None = None,
    ) -> Iterator[SweepRecord]:
        """Yield records, point by point.

        Parameters
        ----------
        quantity, statistic, region
            As in `figure`.
        methods, scene
            Labels of methods and scene; default: all.
        seed
            A single seed; default: all seeds together.
        """
        wanted = None if methods is None else set(methods)
        for row in self.rows:
            entries = (row.quantity, row.statistic, row.region, row.seed)
            if entries != (quantity, statistic, region, seed):
                continue
            if (wanted is None or row.method in wanted) and scene in (None, row.scene):
                yield row
