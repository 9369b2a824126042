"""The result of a sweep: its records as a tidy table, and the best levels."""

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
"""What is told of errors: root of the mean square, mean, standard deviation between seeds, median of the absolute
error; and the share of the pixels that is told."""


@dataclass(frozen=True)
class SweepRecord:
    """One figure.

    ``values``: What was varied: values by path.
    ``scene``: What the scene is called.
    ``method``: Label of the method; ``bound``, perhaps with the method whose window it has, where it is the Cramér-Rao
      bound.
    ``seed``: The scene's seed; None for figures of all seeds.
    ``region``: Region of the score: ``all``, ``interior``, ``object_NAME``.
    ``quantity``: What was measured: a key of `scenetruth.scoring.QUANTITIES`.
    ``statistic``: One of `STATISTICS`.
    ``value``: The figure.
    ``ci_low``, ``ci_high``: Its 95 % confidence interval over seeds; NaN if there is none.
    ``unit``: Its unit.
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
        """Whether it is no error, but the bound of noise."""
        return self.method.split(" ")[0] == "bound"


_COLUMNS = ("scene", "method", "seed", "region", "quantity", "statistic", "value", "ci_low", "ci_high", "unit")


@dataclass(frozen=True)
class Sweep(Result):
    """Figures of methods over what varies.

    Parameters
    ----------
    factors
        Paths of what varies.
    scenes
        What the scenes are called.
    methods
        Labels of the methods.
    rows
        All figures.
    failures
        What gave nothing: lines to read.
    notes
        What else is to be known: lines to read.
    folder
        Where it lies; None if it was not kept.
    grows
        Whether anything grows: of what does not, errors of growth are in the table alone.
    is_grid
        Whether points are all combinations of values, and none fill ranges.
    logarithmic
        Factors that are drawn on a logarithmic scale, whatever their values.

    See Also
    --------
    sweep : Makes it.

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

    Every point, and what noise alone leaves at least:

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
        """Return all figures, a row each.

        Returns
        -------
        pandas.DataFrame
            A column for each factor, by its path: numbers, or what values are called that are none. Then the other
            fields of `scenetruth.design.sweeps.sweep_result.SweepRecord`; ``seed`` is missing where figures are of all
            seeds.
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
            If there is none; the message names what was asked for.
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
        """Return the best figure of all seeds: the one nearest to 0, or of ``density`` the largest.

        Parameters
        ----------
        quantity, statistic, region, scene
            As of `value`; all scenes if none is given.
        method
            Only this method; all if not given.

        Raises
        ------
        ArgumentError
            If there is none.
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
        """Give figures, point by point.

        Parameters
        ----------
        quantity, statistic, region
            What is told.
        methods, scene
            Of which methods and scene; all if not given.
        seed
            Of a single seed; of all together if not given.
        """
        wanted = None if methods is None else set(methods)
        for row in self.rows:
            told = (row.quantity, row.statistic, row.region, row.seed)
            if told != (quantity, statistic, region, seed):
                continue
            if (wanted is None or row.method in wanted) and scene in (None, row.scene):
                yield row
