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
from scenetruth.scoring.quantities import get_title

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Budget", "number", "unit_text"]


_UNITS = {"mm/frame": "mm per frame", "px/step": "px per step", "%/h": "% per hour"}
# A source with a smaller fraction of the sum of squares is not named.
_LEAST_NAMED_SHARE = 0.02
# Largest relative difference between the root sum of squares and the simulated total that is not reported.
_AGREE = 0.2


def number(value: float) -> str:
    """Format a number with two digits, without an exponent where possible."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        return f"{float(f'{value:.1e}'):.10g}" if abs(value) < 1e2 else f"{value:.0f}"
    return f"{value:.1e}"


def unit_text(unit: str) -> str:
    """Return a unit spelled out."""
    return _UNITS.get(unit, unit)


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
        # Disparity is equivalent to depth.
        if one.region == region and one.quantity != "disparity"
    ]


def _summarise_quantity(
    everything: Sequence[Contribution], total: CombinedUncertainty, remedies: Mapping[str, Mitigation]
) -> str:
    quantity, parts = total.quantity, _usable(everything)
    unit, title = unit_text(total.unit), get_title(quantity)
    if quantity == GROWTH:
        title = "Growth"
    if not math.isfinite(total.simulated):
        head = (
            f"{title}: no valid estimate with all sources; "
            f"contributions combined in quadrature: {number(total.root_sum_square)} {unit}."
        )
    else:
        head = f"{title}: combined uncertainty {number(total.figure)} {unit} RMS"
        head += (
            f", true value {number(total.signal)} {unit}."
            if quantity != "depth" and total.signal > _NO_SIGNAL * total.figure
            else "."
        )
    if not parts:
        return head
    sentences = [head, *_largest(parts, total)]
    helped = _describe_mitigation(parts, total, remedies)
    sentences += [helped] if helped else []
    if math.isfinite(total.simulated) and abs(total.root_sum_square - total.simulated) > _AGREE * total.simulated:
        text = f"The root sum of squares of the contributions is {number(total.root_sum_square)} {unit}"
        if math.isfinite(total.signed_sum) and abs(total.signed_sum - total.simulated) < _AGREE * total.simulated:
            text += f", but biases partly cancel or add up: their signed sum per pixel is {number(total.signed_sum)}."
        elif not math.isfinite(parts[0].simulated):
            text += ", and the largest is only predicted: simulated_share=1 (--simulated-share 1) simulates it too."
        else:
            text += ": the sources do not act independently."
        sentences.append(text)
    silent = [one for one in everything if one.valid_fraction < _FULL_DENSITY]
    sentences += [f"With {one.title}, {100 * one.valid_fraction:.0f} % of the pixels remain valid." for one in silent]
    return " ".join(sentences)


_FULL_DENSITY = 0.9
# A true value below this fraction of its error is not reported.
_NO_SIGNAL = 1e-3


def _usable(parts: Sequence[Contribution]) -> list[Contribution]:
    return [one for one in parts if math.isfinite(one.figure) and one.figure > 0]


def _largest(parts: list[Contribution], total: CombinedUncertainty) -> list[str]:
    whole = sum(one.figure**2 for one in parts)
    first, *others = parts
    size = f" ({first.size})" if first.size else ""
    sure = "" if math.isfinite(first.simulated) or first.cause in _METHOD_KINDS else ", as predicted"
    text = f"{_capital(first.title)}{size} contributes {number(first.figure)} of this{sure}"
    if first.cause in _PLURAL:
        text = text.replace(" contributes ", " contribute ", 1)
    if math.isfinite(first.predicted_for_seeds) and not 1 / _SEED_RATIO < first.predicted / first.figure < _SEED_RATIO:
        text += f" for these seeds, with an expected value of {number(first.predicted)} over all seeds"
    named = [one for one in others[:2] if one.figure**2 > _LEAST_NAMED_SHARE * whole]
    if named:
        text += ", followed by " + ", ".join(f"{one.title} {number(one.figure)}" for one in named)
    return [text + "."]


_METHOD_KINDS = ("slope", "curvature", "edges", "rest")
_PLURAL = ("slope", "curvature", "edges")
# Largest ratio between few and many seeds that is not reported.
_SEED_RATIO = 1.5


def _describe_mitigation(
    parts: list[Contribution], total: CombinedUncertainty, remedies: Mapping[str, Mitigation]
) -> str:
    """Return the effect of the mitigation of the largest contribution, and what limits then."""
    first = parts[0]
    remedy = remedies.get(first.cause)
    if remedy is None or not remedy.factors:
        return ""
    left = {one.cause: one.figure * remedy.factors.get(one.cause, 1.0) for one in parts}
    after = math.sqrt(sum(value**2 for value in left.values()))
    # Scaled to the simulated total, as contributions may not be independent.
    after *= total.figure / math.sqrt(sum(one.figure**2 for one in parts))
    limits = max(left, key=lambda cause: left[cause])
    unit = unit_text(total.unit)
    text = f"{_capital(remedy.words)} reduces it to {number(after)} {unit}"
    if limits == first.cause:
        return text + "; it remains the largest contribution."
    title = next(one.title for one in parts if one.cause == limits)
    limit = "dominate" if limits in _PLURAL else "dominates"
    return f"{text}; then {title} {limit} ({number(left[limits])})."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


@dataclass(frozen=True)
class Budget:
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
    >>> for sentence in found.words()[0].split(". "):
    ...     print(sentence)
    Depth: combined uncertainty 0.37 mm RMS
    Sensor noise (0.4 % of full scale) contributes 0.36 of this, followed by focal length 0.25
    The mean of four images (sensor.noise_std: 0.002) reduces it to 0.26 mm; then focal length dominates (0.25).
    >>> part, total = found.part("focal_length", "depth"), found.total("depth")
    >>> f"predicted {part.predicted:.2f} mm, simulated {part.simulated:.2f} mm of {total.simulated:.2f} mm"
    'predicted 0.25 mm, simulated 0.25 mm of 0.37 mm'
    """

    scene: str
    method: str
    parts: Sequence[Contribution] = field(repr=False)
    totals: Sequence[CombinedUncertainty] = field(repr=False)
    draws: int
    remedies: dict[str, Mitigation] = field(repr=False)
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

    def of(self, quantity: str, region: str = "interior") -> list[Contribution]:
        """Return the contributions to a quantity in a region in descending order; NaN last."""
        return sort_contributions(self.parts, quantity, region)

    def part(self, cause: str, quantity: str, region: str = "interior") -> Contribution:
        """Return one contribution.

        Raises
        ------
        KeyError
            If there is no such contribution.
        """
        for one in self.parts:
            if (one.cause, one.quantity, one.region) == (cause, quantity, region):
                return one
        msg = f"no contribution of {cause} to {quantity}, {region}"
        raise KeyError(msg)

    def total(self, quantity: str, region: str = "interior") -> CombinedUncertainty:
        """Return the combined uncertainty of a quantity in a region.

        Raises
        ------
        KeyError
            If there is no such quantity or region.
        """
        for one in self.totals:
            if (one.quantity, one.region) == (quantity, region):
                return one
        msg = f"no budget of {quantity} in {region}"
        raise KeyError(msg)

    def to_frame(self) -> pd.DataFrame:
        """Return a table with a row for each source, quantity and region, and rows for the combined uncertainties.

        Columns are the fields of `Contribution`. The combined uncertainties have the causes ``root_sum_square``,
        ``signed_sum``, ``everything`` and ``ideal``.
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
                    "figure": one.root_sum_square,
                }
            )
            rows.append({"cause": "signed_sum", "title": "signed sum per pixel", **place, "figure": one.signed_sum})
            told = {"simulated": one.simulated, "figure": one.simulated, "valid_fraction": one.valid_fraction}
            rows.append({"cause": "everything", "title": "all sources", **place, **told})
            told = {"simulated": one.ideal, "figure": one.ideal}
            rows.append({"cause": "ideal", "title": "ideal images", **place, **told})
        return pd.DataFrame(rows, columns=list(Contribution.__dataclass_fields__))

    def words(self, region: str = "interior") -> list[str]:
        """Return a summary for each quantity: largest contributions and the most effective mitigation."""
        return summarise_budget(self.parts, self.totals, self.remedies, region)
