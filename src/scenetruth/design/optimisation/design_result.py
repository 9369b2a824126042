"""The result of an optimisation: recommended rig, Pareto front, sensitivities, summary and serialisation."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenetruth.design.optimisation.design_records import (
    STATISTICS,
    Discrepancy,
    Objective,
    PredictionInterval,
    RankConsistency,
    RigDesign,
    RuleOfThumb,
    Sensitivity,
    compute_rig_interval,
    decide_rig_target,
    describe_decision,
)
from scenetruth.design.optimisation.standard_lens import StandardLens, describe_standard_lens
from scenetruth.design.parameter_words import title_parameter
from scenetruth.errors import ArgumentError, Problem, StoreError
from scenetruth.output import claim_folder, write_atomically
from scenetruth.plain_data import parse_json
from scenetruth.results import QuantityValue, Result, from_plain_data, refuse_unknown, to_plain_data

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "RESULT_FILE",
    "SCREENING_FILE",
    "SUFFICIENT_DENSITY",
    "DesignResult",
    "compose_summary",
    "describe_rank_consistency",
    "format_parameter",
    "write_screening_table",
]


_TEXT_COLUMNS = ("phase", "problem")


def write_screening_table(table: pd.DataFrame, file: Path) -> None:
    """Write all evaluations; values that are neither numbers nor texts are written as JSON."""
    entries = table.copy()
    for name in entries.columns:
        if entries[name].dtype == object and name not in _TEXT_COLUMNS:
            entries[name] = [_text(value) for value in entries[name]]
    entries.to_csv(file, index=False)


def read_screening_table(file: Path, variables: Mapping[str, Any]) -> pd.DataFrame:
    """Return all evaluations of a file."""
    import pandas as pd

    table = pd.read_csv(file, dtype=str, keep_default_na=False)
    found = {}
    for name in table.columns:
        choices = {_text(value): value for value in _choices(variables.get(name))}
        is_text = name in _TEXT_COLUMNS or (name in variables and not _is_range(variables[name]))
        found[name] = [choices.get(text, text) if is_text else _number(text) for text in table[name]]
    return pd.DataFrame(found)


def _choices(variable: Any) -> list[Any]:
    values = variable.get("values") if isinstance(variable, Mapping) else variable
    return list(values) if isinstance(values, list | tuple) else []


def _text(value: Any) -> str:
    is_plain = isinstance(value, str) or (isinstance(value, int | float) and not isinstance(value, bool))
    return str(value) if is_plain else json.dumps(value, ensure_ascii=False)


def _is_range(variable: Any) -> bool:
    return isinstance(variable, Mapping) and variable.get("from") is not None


def _number(text: str) -> float | int | bool:
    if text in ("True", "False"):
        return text == "True"
    try:
        return int(text)
    except ValueError:
        return float(text or "nan")


_MOST_LISTED = 3
SUFFICIENT_DENSITY = 0.9
"""Density of a region below which the summary reports it."""


def compose_summary(
    objectives: Sequence[Objective],
    rig: RigDesign,
    sensitivities: Sequence[Sensitivity],
    discrepancies: Sequence[Discrepancy],
    rules: Sequence[RuleOfThumb],
    orders: Sequence[RankConsistency] = (),
) -> tuple[str, ...]:
    """Return the lines of a summary text."""
    values = ", ".join(f"{name} = {format_parameter(value)}" for name, value in rig.parameters.items())
    found = [f"recommended, rig {rig.number}: {values}", *_reached(objectives, rig)]
    if rig.limits:
        found.append(f"limits: {rig.limits}")
    found += _changed(objectives, sensitivities)
    found += _compared(discrepancies)
    found += describe_rank_consistency(objectives, orders)
    broken = [one.title for one in rules if not one.holds]
    return tuple(found + ([f"rules of thumb not satisfied: {', '.join(broken)}"] if broken else []))


def format_parameter(value: Any) -> str:
    """Return the text of a parameter value."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def describe_rank_consistency(objectives: Sequence[Objective], orders: Sequence[RankConsistency]) -> Iterator[str]:
    """Yield a line on the rank consistency of simulated rigs for each objective."""
    for objective in objectives:
        own = [one for one in orders if one.objective == objective.title]
        count = Counter(one.verdict for one in own)
        if own:
            pairs = f"{len(own)} pair{'s' if len(own) > 1 else ''} of rigs"
            seeds = min(one.seeds for one in own)
            parts = [f"{count['kept']} confirmed"] if count["kept"] else []
            parts += [f"{count['swapped']} reversed"] if count["swapped"] else []
            parts += [f"{count['undecided']} undecided with {seeds} seeds"] if count["undecided"] else []
            yield f"{objective.title}: predicted order of {pairs} in the simulations: {', '.join(parts)}"


def _changed(objectives: Sequence[Objective], sensitivities: Sequence[Sensitivity]) -> Iterator[str]:
    entries = [one for one in sensitivities if math.isfinite(one.ten_percent)]
    for objective in objectives:
        own = sorted(
            (one for one in entries if one.objective == objective.title), key=lambda one: -abs(one.ten_percent)
        )
        parts = [
            f"{title_parameter(one.parameter)} {_signed(one.ten_percent)} ({_signed(one.ten_percent_less)})"
            for one in own
        ]
        if parts:
            most = ", ".join(parts[:_MOST_LISTED])
            title = f"{objective.title[0].lower()}{objective.title[1:]}"
            yield f"an increase (decrease) of each parameter by 10 % changes {title} by: {most}"


def _signed(share: float) -> str:
    return f"{100 * share:+.1f} %" if math.isfinite(share) else "–"


def _compared(discrepancies: Sequence[Discrepancy]) -> Iterator[str]:
    notable, count = [one for one in discrepancies if one.notable], len(discrepancies)
    if count == 1:
        compared = "differs notably from" if notable else "agrees with"
        words = f"the simulated value {compared} its prediction"
    else:
        values = f"{len(notable)} of {count} simulated values differ notably from"
        words = f"{values if notable else f'all {count} simulated values agree with'} their prediction"
    if count:
        yield words if notable else f"{words}, within the scatter of seeds or 30 %"
    yield from (f"rig {one.rig}: {one.says}" for one in notable)


def _reached(objectives: Sequence[Objective], rig: RigDesign) -> Iterator[str]:
    for one in objectives:
        line = f"{one.title}: {one.statistic_title}, predicted {rig.predicted[one.title]:.3g} {one.unit}"
        found = rig.simulated.get(one.title)
        if found is not None:
            line += f", simulated {found.value:.3g} ({_seeds(found)}{_compare_rmse(rig, one)})"
            if rig.density(one.title) < SUFFICIENT_DENSITY:
                line += f"; only {100 * rig.density(one.title):.0f} % of the pixels are valid"
        decision = decide_rig_target(rig, one)
        if decision is not None:
            line += f"; target {one.wanted:g}: {describe_decision(decision, one.unit)}"
        elif one.wanted is not None:
            prediction = "meets" if rig.predicted[one.title] <= one.wanted else "does not meet"
            line += f"; target {one.wanted:g}: Undecided: the prediction {prediction} it, without a simulation"
        yield line


def _seeds(found: PredictionInterval) -> str:
    if found.seeds < 2 or not math.isfinite(found.pi_low):
        return f"from {'one seed' if found.seeds == 1 else f'{found.seeds} seeds'}: no interval"
    return f"95 % prediction interval {found.pi_low:.3g} to {found.pi_high:.3g}, from {found.seeds} seeds"


def _compare_rmse(rig: RigDesign, objective: Objective) -> str:
    """Return the RMSE, which includes outliers, if the objective has another statistic."""
    rms = compute_rig_interval(rig, objective.title, "rmse")
    return f"; RMSE {rms.value:.3g}" if objective.statistic != "rmse" and rms.seeds else ""


RESULT_FILE, SCREENING_FILE = "design.json", "evaluations.csv"
"""Files of a design directory: the result as plain data, and the table of all evaluations."""
_FORMAT = 4
_PARTS: Mapping[str, Any] = {
    "title": str,
    "objectives": tuple[Objective, ...],
    "front": tuple[RigDesign, ...],
    "alternatives": tuple[RigDesign, ...],
    "orders": tuple[RankConsistency, ...],
    "sensitivities": tuple[Sensitivity, ...],
    "rules": tuple[RuleOfThumb, ...],
    "assumptions": tuple[str, ...],
    "discrepancies": tuple[Discrepancy, ...],
    "seconds": Mapping[str, float],
    "standard_lens": StandardLens | None,
}


@dataclass(frozen=True, eq=False)
class DesignResult(Result):
    """The result of an optimisation: recommended rig, Pareto front, alternatives and their analysis.

    Parameters
    ----------
    specification
        The design specification as plain data.
    title
        Title of the design.
    objectives
        The objectives.
    recommended
        The recommended rig, from the front or the alternatives.
    front
        Non-dominated rigs by prediction, sorted by the first objective.
    screened
        Table of all evaluations: parameters by path, objectives by title, ``holds``, ``excess`` and ``phase``.
    sensitivities
        Sensitivities of the objectives to the parameters.
    rules
        Rules of thumb, evaluated for the recommended rig.
    assumptions
        Descriptions of the assumptions.
    discrepancies
        Comparison of prediction and simulation for every simulated rig.
    folder
        Output directory; None without one.
    seconds
        Run time of each step in seconds.
    alternatives
        Nearly as good rigs that differ from those of a small front.
    orders
        Rank consistency of all pairs of simulated rigs.
    standard_lens
        Nearest lens of the catalogue and f-stop, and the predictions with them; None without a pixel pitch.

    See Also
    --------
    scenetruth.design.optimisation.optimise : Optimise a rig.
    scenetruth.design.optimisation.report.design_report.write_design_page : Write the report.

    Examples
    --------
    >>> from scenetruth.design.optimisation import optimise
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [4, 16]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 4}, "frames": {"count": 3}, "sensor": {"noise_std": 0.01}}
    >>> spec = {"title": "A wall", "scene": scene, "variables": {"stage.baseline_mm": {"values": [4, 6, 8, 10]}}}
    >>> spec |= {"constraints": [{"kind": "stage_travel", "max": 16}], "objectives": [{"quantity": "depth"}]}
    >>> spec |= {"search": {"predictions": 16, "morris_trajectories": 0, "sobol": 0}, "confirmation": {"rigs": 0}}
    >>> design = optimise(spec)
    >>> print(design.summary().splitlines()[1])
    Depth: scaled median absolute error, predicted 0.163 mm
    >>> for rig in design.rigs:
    ...     print(f"baseline {rig.parameters['stage.baseline_mm']} mm: depth to {rig.predicted['Depth']:.2f} mm")
    baseline 8 mm: depth to 0.16 mm
    baseline 6 mm: depth to 0.22 mm
    baseline 4 mm: depth to 0.33 mm

    The table of evaluations includes rigs that violate constraints:

    >>> design.screened[["stage.baseline_mm", "holds"]].sort_values("stage.baseline_mm").values.tolist()
    [[4, True], [6, True], [8, True], [10, False]]
    """

    specification: Mapping[str, Any] = field(repr=False)
    title: str
    objectives: tuple[Objective, ...]
    recommended: RigDesign
    front: tuple[RigDesign, ...]
    screened: pd.DataFrame = field(repr=False)
    sensitivities: tuple[Sensitivity, ...]
    rules: tuple[RuleOfThumb, ...]
    assumptions: tuple[str, ...]
    discrepancies: tuple[Discrepancy, ...]
    folder: Path | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    alternatives: tuple[RigDesign, ...] = ()
    orders: tuple[RankConsistency, ...] = ()
    standard_lens: StandardLens | None = None

    @property
    def rigs(self) -> tuple[RigDesign, ...]:
        """The front and the alternatives, sorted by the first objective."""
        titles = [one.title for one in self.objectives]
        return tuple(sorted((*self.front, *self.alternatives), key=lambda rig: [rig.predicted[one] for one in titles]))

    def to_dataframe(self) -> pd.DataFrame:
        """Return a table of the front and the alternatives, one row per rig.

        Returns
        -------
        pandas.DataFrame
            ``rig``, ``recommended``, ``front`` (member of the front), a column for each parameter; for each objective
            ``TITLE``, ``TITLE simulated``, ``TITLE pi_low``, ``TITLE pi_high`` (missing without simulations);
            ``price`` and ``limits``.
        """
        import pandas as pd

        nothing = PredictionInterval(math.nan, math.nan, math.nan, 0)
        first = {rig.number for rig in self.front}
        rows = []
        for rig in self.rigs:
            row: dict[str, Any] = {"rig": rig.number, "recommended": rig.number == self.recommended.number}
            row |= {"front": rig.number in first, **rig.parameters}
            for objective in self.objectives:
                title, found = objective.title, rig.simulated.get(objective.title, nothing)
                row |= {title: rig.predicted[title], f"{title} simulated": found.value}
                row |= {f"{title} pi_low": found.pi_low, f"{title} pi_high": found.pi_high}
            rows.append({**row, "price": rig.price, "limits": rig.limits})
        return pd.DataFrame(rows)

    def value(
        self, quantity: str, statistic: str | None = None, *, region: str = "interior", rig: int | None = None
    ) -> QuantityValue:
        """Return a statistic of the errors of one objective's quantity.

        Parameters
        ----------
        quantity, region
            Quantity and region of one of the objectives.
        statistic
            The statistic: ``scaled_median_abs_error``, ``rmse`` or ``p95_abs_error``; by default that of the objective.
        rig
            Number of the rig; by default the recommended one.

        Returns
        -------
        QuantityValue
            From simulations if the rig was simulated, with the 95 % prediction interval of a further recording and the
            number of seeds; otherwise predicted, without an interval.

        Raises
        ------
        ArgumentError
            If there is no such objective, rig or statistic.
        """
        refuse_unknown(
            quantity=((quantity, region), [(one.quantity, one.region) for one in self.objectives]),
            rig=(self.recommended.number if rig is None else rig, [one.number for one in self.rigs]),
            statistic=(statistic, [None, *STATISTICS]),
        )
        objective = next(one for one in self.objectives if (one.quantity, one.region) == (quantity, region))
        chosen = self.recommended if rig is None else next(one for one in self.rigs if one.number == rig)
        wanted = statistic or objective.statistic
        simulated = chosen.simulated.get(objective.title)
        if simulated is None or wanted != objective.statistic:
            simulated = compute_rig_interval(chosen, objective.title, wanted)
        if simulated.seeds:
            return QuantityValue(
                value=simulated.value,
                unit=objective.unit,
                ci_low=simulated.pi_low,
                ci_high=simulated.pi_high,
                statistic=wanted,
                region=region,
                n=simulated.seeds,
            )
        if wanted != objective.statistic:
            message = f"is predicted as {objective.statistic} only; rig {chosen.number} was not simulated"
            raise ArgumentError([Problem("statistic", message, wanted)])
        return QuantityValue(chosen.predicted[objective.title], objective.unit, statistic=wanted, region=region)

    def summary(self) -> str:
        """Return the recommended rig, its lens, errors, limits and sensitivities, one statement per line."""
        lines = compose_summary(
            self.objectives, self.recommended, self.sensitivities, self.discrepancies, self.rules, self.orders
        )
        bought = describe_standard_lens(self.standard_lens, self.objectives, self.recommended)
        return "\n".join([*lines, *bought])

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``design.json``: all but the table of evaluations as plain data.

        Non-finite numbers are None (NaN), ``"inf"`` and ``"-inf"``.
        """
        entries = {name: to_plain_data(getattr(self, name)) for name in _PARTS}
        more = {"recommended": self.recommended.number, "summary": self.summary().splitlines()}
        return {"format": _FORMAT, "specification": to_plain_data(self.specification), **entries, **more}

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Save the result in a directory, as `optimise` does with ``output``: ``design.json`` and ``evaluations.csv``.

        Parameters
        ----------
        path
            The directory to write.
        overwrite
            Whether an existing result may be replaced.

        Raises
        ------
        OutputExistsError
            If the directory exists and ``overwrite`` is false.
        """
        folder = Path(path)
        with write_atomically(folder, overwrite=overwrite, claim=claim_folder(RESULT_FILE)) as partial:
            partial.mkdir()
            (partial / RESULT_FILE).write_text(
                json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
            )
            write_screening_table(self.screened, partial / SCREENING_FILE)
        return folder

    @classmethod
    def load(cls, path: str | Path) -> DesignResult:
        """Load the result of `optimise` from its output directory.

        Parameters
        ----------
        path
            The directory; ``design.json`` and ``evaluations.csv`` in it are read.

        Raises
        ------
        StoreError
            If a file is missing, damaged, or of another version.

        Examples
        --------
        Write the report again without an optimisation:

        >>> from scenetruth.design.optimisation.report.design_report import write_design_page
        >>> write_design_page(DesignResult.load("outputs/rig"), "outputs/rig")  # doctest: +SKIP
        """
        place = Path(path)
        file = place / RESULT_FILE
        remedy = "run 'scenetruth design optimise' again; existing predictions and simulations are reused"
        try:
            plain = parse_json(file.read_bytes())
            if isinstance(plain, dict) and plain.get("format") != _FORMAT:
                raise StoreError(file, f"has format {plain.get('format')} instead of {_FORMAT}; {remedy}")
            parts = {name: from_plain_data(kind, plain[name]) for name, kind in _PARTS.items()}
            specification = dict(plain["specification"])
            (best,) = (rig for rig in (*parts["front"], *parts["alternatives"]) if rig.number == plain["recommended"])
            file = place / SCREENING_FILE
            table = read_screening_table(file, specification.get("variables", {}))
        except FileNotFoundError as error:
            raise StoreError(file, f"is missing; {remedy}") from error
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StoreError(file, f"is damaged ({type(error).__name__}: {error}); {remedy}") from error
        return cls(specification=specification, recommended=best, screened=table, folder=place, **parts)
