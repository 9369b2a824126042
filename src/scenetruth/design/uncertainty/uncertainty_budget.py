"""The uncertainty budget as a result: contributions, combined standard uncertainty, and a summary in sentences."""

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

__all__ = ["Budget", "number", "summarise_budget", "unit_text"]


_UNITS = {"mm/frame": "mm per frame", "px/step": "px per step", "%/h": "% per hour"}
# A cause whose share of the sum of squares is less is not worth a sentence.
_LEAST_NAMED_SHARE = 0.02
# Where the parts and the whole differ by more, they are no sum.
_AGREE = 0.2


def number(value: float) -> str:
    """Spell a number with two digits, without a power of ten where it is readable without."""
    if not math.isfinite(value):
        return "–"
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        return f"{float(f'{value:.1e}'):.10g}" if abs(value) < 1e2 else f"{value:.0f}"
    return f"{value:.1e}"


def unit_text(unit: str) -> str:
    """Return a unit as people say it."""
    return _UNITS.get(unit, unit)


def summarise_budget(
    parts: Sequence[Contribution],
    totals: Sequence[CombinedUncertainty],
    remedies: Mapping[str, Mitigation],
    region: str,
) -> list[str]:
    """Return what is to be said of each quantity: the error, the largest part, what helps, and what limits then.

    Parameters
    ----------
    parts, totals, remedies
        Those of a budget.
    region
        Where.
    """
    return [
        _summarise_quantity(sort_contributions(parts, one.quantity, region), one, remedies)
        for one in totals
        # The disparity is the depth again.
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
            f"{title}: with everything on, nothing is told; the parts add up to {number(total.root_sum_square)} {unit}."
        )
    else:
        head = f"{title}: {number(total.figure)} {unit} in all"
        head += (
            f", of a true {number(total.signal)} {unit}."
            if quantity != "depth" and total.signal > _NO_SIGNAL * total.figure
            else "."
        )
    if not parts:
        return head
    sentences = [head, *_largest(parts, total)]
    helped = _describe_mitigation(parts, total, remedies)
    sentences += [helped] if helped else []
    if math.isfinite(total.simulated) and abs(total.root_sum_square - total.simulated) > _AGREE * total.simulated:
        text = f"The parts' squares add up to {number(total.root_sum_square)} {unit}"
        if math.isfinite(total.signed_sum) and abs(total.signed_sum - total.simulated) < _AGREE * total.simulated:
            text += f", but biases have signs: added up pixel by pixel, they make {number(total.signed_sum)}."
        elif not math.isfinite(parts[0].simulated):
            text += ", and the largest is predicted alone: simulated_share=1 (--simulated-share 1) simulates it too."
        else:
            text += ": together, causes do more or less than alone."
        sentences.append(text)
    silent = [one for one in everything if one.valid_fraction < _FULL_DENSITY]
    sentences += [f"With {one.title}, {100 * one.valid_fraction:.0f} % of the pixels are still told." for one in silent]
    return " ".join(sentences)


_FULL_DENSITY = 0.9
# Less than this share of its error is no motion or growth at all.
_NO_SIGNAL = 1e-3


def _usable(parts: Sequence[Contribution]) -> list[Contribution]:
    return [one for one in parts if math.isfinite(one.figure) and one.figure > 0]


def _largest(parts: list[Contribution], total: CombinedUncertainty) -> list[str]:
    whole = sum(one.figure**2 for one in parts)
    first, *others = parts
    size = f" ({first.size})" if first.size else ""
    sure = "" if math.isfinite(first.simulated) or first.cause in _METHOD_KINDS else ", as predicted"
    text = f"{_capital(first.title)}{size} makes {number(first.figure)} of it{sure}"
    if first.cause in _PLURAL:
        text = text.replace(" makes ", " make ", 1)
    if math.isfinite(first.predicted_for_seeds) and not 1 / _SEED_RATIO < first.predicted / first.figure < _SEED_RATIO:
        text += f" in these draws, and {number(first.predicted)} is to be expected of others"
    named = [one for one in others[:2] if one.figure**2 > _LEAST_NAMED_SHARE * whole]
    if named:
        text += "; then " + ", ".join(f"{one.title} {number(one.figure)}" for one in named)
    return [text + "."]


_METHOD_KINDS = ("slope", "curvature", "edges", "rest")
_PLURAL = ("slope", "curvature", "edges")
# What few draws make differs from what many make by more than this only by chance.
_SEED_RATIO = 1.5


def _describe_mitigation(
    parts: list[Contribution], total: CombinedUncertainty, remedies: Mapping[str, Mitigation]
) -> str:
    """Say what the remedy of the largest part does, and what limits then."""
    first = parts[0]
    remedy = remedies.get(first.cause)
    if remedy is None or not remedy.factors:
        return ""
    left = {one.cause: one.figure * remedy.factors.get(one.cause, 1.0) for one in parts}
    after = math.sqrt(sum(value**2 for value in left.values()))
    # Where the parts are no sum, they say by which share it is less.
    after *= total.figure / math.sqrt(sum(one.figure**2 for one in parts))
    limits = max(left, key=lambda cause: left[cause])
    unit = unit_text(total.unit)
    text = f"{_capital(remedy.words)} brings it to {number(after)} {unit}"
    if limits == first.cause:
        return text + "; it limits still."
    title = next(one.title for one in parts if one.cause == limits)
    limit = "limit" if limits in _PLURAL else "limits"
    return f"{text}; then {title} {limit} ({number(left[limits])})."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


@dataclass(frozen=True)
class Budget:
    """The error budget of a scene and a method.

    Parameters
    ----------
    scene
        What the scene is for.
    method
        The method.
    parts
        The parts of all causes.
    totals
        Their sums.
    draws
        How many seeds were simulated.
    remedies
        What helps against each cause.
    failures
        What could not be simulated, and why: lines to read.
    folder
        Where it lies; None if it was not kept.

    See Also
    --------
    scenetruth.design.uncertainty.budget : Makes it.

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
    Depth: 0.37 mm in all
    Noise of the sensor (0.4 % of full scale) makes 0.36 of it; then focal length 0.25
    The mean of four images (sensor.noise_std: 0.002) brings it to 0.26 mm; then focal length limits (0.25).
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
        """What it tells of, in the order of scores."""
        return list(dict.fromkeys(one.quantity for one in self.totals))

    @property
    def regions(self) -> list[str]:
        """Where: ``all``, ``interior``, objects."""
        return list(dict.fromkeys(one.region for one in self.totals))

    def of(self, quantity: str, region: str = "interior") -> list[Contribution]:
        """Return the parts of one quantity in one region, the largest first; unknown ones last."""
        return sort_contributions(self.parts, quantity, region)

    def part(self, cause: str, quantity: str, region: str = "interior") -> Contribution:
        """Return one part.

        Raises
        ------
        KeyError
            If there is none.
        """
        for one in self.parts:
            if (one.cause, one.quantity, one.region) == (cause, quantity, region):
                return one
        msg = f"there is no part of {cause} in {quantity}, {region}"
        raise KeyError(msg)

    def total(self, quantity: str, region: str = "interior") -> CombinedUncertainty:
        """Return the sum of the parts, and what it is compared with.

        Raises
        ------
        KeyError
            If there is none.
        """
        for one in self.totals:
            if (one.quantity, one.region) == (quantity, region):
                return one
        msg = f"there is no budget of {quantity} in {region}"
        raise KeyError(msg)

    def to_frame(self) -> pd.DataFrame:
        """Return all figures, a row for each cause, quantity and region, and those of the whole.

        Columns are the fields of `Contribution`. Rows of the whole have the causes ``root_sum_square``, ``signed_sum``,
        ``everything`` and ``radiance``.
        """
        import pandas as pd

        rows = [asdict(one) for one in self.parts]
        for one in self.totals:
            place = {"quantity": one.quantity, "region": one.region, "unit": one.unit, "size": ""}
            rows.append(
                {
                    "cause": "root_sum_square",
                    "title": "root of the sum of squares",
                    **place,
                    "figure": one.root_sum_square,
                }
            )
            rows.append({"cause": "signed_sum", "title": "added up pixel by pixel", **place, "figure": one.signed_sum})
            told = {"simulated": one.simulated, "figure": one.simulated, "valid_fraction": one.valid_fraction}
            rows.append({"cause": "everything", "title": "everything on", **place, **told})
            told = {"simulated": one.ideal, "figure": one.ideal}
            rows.append({"cause": "ideal", "title": "ideal images", **place, **told})
        return pd.DataFrame(rows, columns=list(Contribution.__dataclass_fields__))

    def words(self, region: str = "interior") -> list[str]:
        """Return what limits and what helps most, a sentence or two for each quantity."""
        return summarise_budget(self.parts, self.totals, self.remedies, region)
