"""Result of an uncertainty budget: contributions, combined standard uncertainty, and a summary in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenetruth.design.uncertainty.contributions import CombinedUncertainty, Contribution, sort_contributions
from scenetruth.design.uncertainty.simulation_runs import GROWTH
from scenetruth.design.uncertainty.source import Mitigation
from scenetruth.errors import ArgumentError, Problem
from scenetruth.number_format import format_two_digits, format_unit
from scenetruth.results import QuantityValue, Result, refuse_unknown
from scenetruth.scoring.quantities import get_title

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Budget"]


_LEAST_NAMED_SHARE = 0.02  # a source with a smaller fraction of the sum of squares is not named
_AGREE = 0.2  # largest relative difference between the root sum of squares and the simulated total that is not reported


def summarise_budget(
    parts: Sequence[Contribution],
    totals: Sequence[CombinedUncertainty],
    remedies: Mapping[str, Mitigation],
    region: str,
) -> list[str]:
    """Return a summary per quantity: the error, the largest contribution, its mitigation, and what limits then."""
    return [
        _summarise_quantity(sort_contributions(parts, one.quantity, region), one, remedies)
        for one in totals
        if one.region == region and one.quantity != "disparity"  # disparity is equivalent to depth
    ]


def _summarise_quantity(
    everything: Sequence[Contribution], total: CombinedUncertainty, remedies: Mapping[str, Mitigation]
) -> str:
    quantity, parts = total.quantity, _usable(everything)
    unit, title = format_unit(total.unit), get_title(quantity)
    if quantity == GROWTH:
        title = "Growth"
    if not math.isfinite(total.simulated):
        head = (
            f"{title}: no valid estimate with all sources; "
            f"contributions combined in quadrature: {format_two_digits(total.root_sum_square)} {unit}."
        )
    else:
        head = f"{title}: {_describe_size(total)}."
    if not parts:
        return head
    sentences = [head, *_largest(parts, total)]
    helped = _describe_mitigation(parts, total, remedies)
    sentences += [helped] if helped else []
    if math.isfinite(total.simulated) and abs(total.root_sum_square - total.simulated) > _AGREE * total.simulated:
        text = f"The root sum of squares of the contributions is {format_two_digits(total.root_sum_square)} {unit}"
        if math.isfinite(total.signed_sum) and abs(total.signed_sum - total.simulated) < _AGREE * total.simulated:
            signed = format_two_digits(total.signed_sum)
            text += f", but biases partly cancel or add up: their signed sum per pixel is {signed}."
        elif not math.isfinite(parts[0].simulated):
            text += ", and the largest is only predicted: simulated_share=1 (--simulated-share 1) simulates it too."
        else:
            text += ": the sources do not act independently."
        sentences.append(text)
    silent = [one for one in everything if one.valid_fraction < _FULL_DENSITY]
    sentences += [f"With {one.title}, {100 * one.valid_fraction:.0f} % of the pixels remain valid." for one in silent]
    return " ".join(sentences)


def _describe_size(total: CombinedUncertainty) -> str:
    """Return the combined uncertainty and the true value, and whether the uncertainty exceeds it."""
    unit, size = format_unit(total.unit), format_two_digits(total.value)
    if total.quantity == "depth" or not total.signal > _NO_SIGNAL * total.value:
        return f"combined uncertainty {size} {unit} RMS"
    signal = f"{format_two_digits(total.signal)} {unit}"
    if total.value <= total.signal:
        return f"combined uncertainty {size} {unit} RMS, true value {signal}"
    factor = format_two_digits(total.value / total.signal)
    return f"not measurable: the combined uncertainty, {size} {unit} RMS, is {factor} times the true value of {signal}"


_FULL_DENSITY = 0.9
_NO_SIGNAL = 1e-3  # a true value below this fraction of its error is not reported


def _usable(parts: Sequence[Contribution]) -> list[Contribution]:
    return [one for one in parts if math.isfinite(one.value) and one.value > 0]


def _largest(parts: list[Contribution], total: CombinedUncertainty) -> list[str]:
    whole = sum(one.value**2 for one in parts)
    first, *others = parts
    unit = format_unit(total.unit)
    size = f" ({first.size})" if first.size else ""
    sure = "" if math.isfinite(first.simulated) or first.cause in _METHOD_KINDS else ", as predicted"
    text = f"Largest contribution: {first.title}{size}, {format_two_digits(first.value)} {unit}{sure}"
    if math.isfinite(first.predicted_for_seeds) and not 1 / _SEED_RATIO < first.predicted / first.value < _SEED_RATIO:
        text += f" for these seeds, with an expected value of {format_two_digits(first.predicted)} over all seeds"
    named = [one for one in others[:2] if one.value**2 > _LEAST_NAMED_SHARE * whole]
    if named:
        text += "; then " + ", ".join(f"{one.title} {format_two_digits(one.value)}" for one in named)
    return [text + "."]


_METHOD_KINDS = ("slope", "curvature", "edges", "rest")
_PLURAL = ("slope", "curvature", "edges")
_SEED_RATIO = 1.5  # largest ratio between few and many seeds that is not reported


def _describe_mitigation(
    parts: list[Contribution], total: CombinedUncertainty, remedies: Mapping[str, Mitigation]
) -> str:
    """Return the effect of the mitigation of the largest contribution, and what limits then."""
    first = parts[0]
    remedy = remedies.get(first.cause)
    if remedy is None or not remedy.factors:
        return ""
    left = {one.cause: one.value * remedy.factors.get(one.cause, 1.0) for one in parts}
    after = math.sqrt(sum(value**2 for value in left.values()))
    # Scaled to the simulated total, as contributions may not be independent.
    after *= total.value / math.sqrt(sum(one.value**2 for one in parts))
    limits = max(left, key=lambda cause: left[cause])
    unit = format_unit(total.unit)
    text = f"{_capital(remedy.words)} reduces it to {format_two_digits(after)} {unit}"
    if limits == first.cause:
        return text + "; it remains the largest contribution."
    title = next(one.title for one in parts if one.cause == limits)
    limit = "dominate" if limits in _PLURAL else "dominates"
    return f"{text}; then {title} {limit} ({format_two_digits(left[limits])})."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


@dataclass(frozen=True)
class Budget(Result):
    """Uncertainty budget of a scene and a method.

    Parameters
    ----------
    scene
        Description of the scene.
    method
        Estimation method.
    parts
        Contributions of all sources.
    totals
        Combined uncertainties.
    draws
        Number of simulated seeds.
    remedies
        Mitigations by source.
    failures
        Messages about simulations that failed.
    folder
        Output folder; None without output.

    See Also
    --------
    scenetruth.design.uncertainty.budget : Computes a budget.

    Examples
    --------
    >>> from scenetruth.design.uncertainty import budget
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"frames": {"count": 3}, "render": {"backend": "raycast"}, "score": {"interior_margin_px": 0}}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2.2}, "sensor": {"noise_std": 0.004, "bit_depth": 12}}
    >>> found = budget(scene, method="structure_tensor", calibration={"focal_length_percent": 0.05}, seeds=1)
    >>> found.quantities
    ['depth', 'disparity', 'velocity_x', 'velocity_y', 'velocity_z']
    >>> for sentence in found.summary().splitlines()[0].split(". "):
    ...     print(sentence)
    Depth: combined uncertainty 0.37 mm RMS
    Largest contribution: sensor noise (0.4 % of full scale), 0.36 mm; then focal length 0.25
    The mean of four images (noise 0.2 % of full scale) reduces it to 0.26 mm; then focal length dominates (0.25).
    >>> part, total = found.contribution("focal_length", "depth"), found.combined("depth")
    >>> f"predicted {part.predicted:.2f} mm, simulated {part.simulated:.2f} mm of {total.simulated:.2f} mm"
    'predicted 0.25 mm, simulated 0.25 mm of 0.37 mm'
    """

    scene: str
    method: str
    parts: Sequence[Contribution] = field(repr=False)
    totals: Sequence[CombinedUncertainty] = field(repr=False)
    draws: int
    remedies: Mapping[str, Mitigation] = field(repr=False)
    failures: Sequence[str] = field(default=(), repr=False)
    folder: Path | None = None

    @property
    def quantities(self) -> list[str]:
        """Quantities in the budget, in the order of scores."""
        return list(dict.fromkeys(one.quantity for one in self.totals))

    @property
    def regions(self) -> list[str]:
        """Regions: ``all``, ``interior``, objects."""
        return list(dict.fromkeys(one.region for one in self.totals))

    def contributions(self, quantity: str, region: str = "interior") -> list[Contribution]:
        """Return the contributions to one quantity in one region, the largest first; undefined values last."""
        return sort_contributions(self.parts, quantity, region)

    def contribution(self, source: str, quantity: str, region: str = "interior") -> Contribution:
        """Return the contribution of one source.

        Parameters
        ----------
        source
            Name of the source of uncertainty, for example ``focal_length``.
        quantity, region
            One of `quantities` and of `regions`.

        Raises
        ------
        ArgumentError
            If there is no such contribution; the message lists those that there are.
        """
        refuse_unknown(
            source=(source, dict.fromkeys(one.cause for one in self.parts)),
            quantity=(quantity, self.quantities),
            region=(region, self.regions),
        )
        place = (source, quantity, region)
        matching = [one for one in self.parts if (one.cause, one.quantity, one.region) == place]
        if not matching:
            raise ArgumentError([Problem("source", f"has no contribution to {quantity} in region {region}", source)])
        return matching[0]

    def combined(self, quantity: str, region: str = "interior") -> CombinedUncertainty:
        """Return the combined uncertainty of one quantity, and the error of the simulation with all sources.

        Raises
        ------
        ArgumentError
            If there is no such quantity or region; the message lists those that there are.
        """
        refuse_unknown(quantity=(quantity, self.quantities), region=(region, self.regions))
        return next(one for one in self.totals if (one.quantity, one.region) == (quantity, region))

    def value(self, quantity: str, statistic: str = "rmse", *, region: str = "interior") -> QuantityValue:
        """Return the error of a quantity with all sources: simulated, or combined where it was not simulated.

        Parameters
        ----------
        quantity, region
            One of `quantities` and of `regions`.
        statistic
            ``rmse``, the only statistic of a budget.

        Returns
        -------
        QuantityValue
            Without an interval; ``n`` is the number of simulated seeds.

        Raises
        ------
        ArgumentError
            If none; the message lists those that there are.
        """
        refuse_unknown(statistic=(statistic, ["rmse"]))
        one = self.combined(quantity, region)
        return QuantityValue(one.value, one.unit, statistic=statistic, region=region, n=self.draws)

    def to_dataframe(self) -> pd.DataFrame:
        """Return a table with a row for each source, quantity and region, and rows for the combined uncertainties.

        Columns are the fields of `Contribution`. The combined uncertainties have the causes ``root_sum_square``,
        ``signed_sum``, ``everything`` and ``ideal_images``.
        """
        import pandas as pd

        rows = [asdict(one) for one in self.parts]
        for one in self.totals:
            place = {"quantity": one.quantity, "region": one.region, "unit": one.unit, "size": ""}
            rows.append(
                {
                    "cause": "root_sum_square",
                    "title": "root sum of squares",
                    **place,
                    "value": one.root_sum_square,
                }
            )
            rows.append({"cause": "signed_sum", "title": "signed sum per pixel", **place, "value": one.signed_sum})
            values = {"simulated": one.simulated, "value": one.simulated, "valid_fraction": one.valid_fraction}
            rows.append({"cause": "everything", "title": "all sources", **place, **values})
            values = {"simulated": one.ideal, "value": one.ideal}
            rows.append({"cause": "ideal_images", "title": "ideal images", **place, **values})
        return pd.DataFrame(rows, columns=list(Contribution.__dataclass_fields__))

    def summary(self, region: str = "interior") -> str:
        """Return the limiting sources and their mitigation, one line per quantity."""
        return "\n".join(summarise_budget(self.parts, self.totals, self.remedies, region))
