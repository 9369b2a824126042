"""What an error budget has found: the part of every cause, their sum, and the error with everything on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenetruth.design.budget.answer.words import words_of
from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.parts import Part, Total, sorted_parts

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Budget"]


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
    scenetruth.design.budget.budget : Makes it.

    Examples
    --------
    >>> from scenetruth.design.budget import budget
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"frames": {"count": 3}, "render": {"backend": "raycast"}, "score": {"interior_margin_px": 0}}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2.2}, "sensor": {"noise_std": 0.004, "bit_depth": 12}}
    >>> found = budget(scene, method="structure_tensor", calibration={"focal_length_percent": 0.05}, draws=1)
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
    parts: Sequence[Part] = field(repr=False)
    totals: Sequence[Total] = field(repr=False)
    draws: int
    remedies: dict[str, Remedy] = field(repr=False)
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

    def of(self, quantity: str, region: str = "interior") -> list[Part]:
        """Return the parts of one quantity in one region, the largest first; unknown ones last."""
        return sorted_parts(self.parts, quantity, region)

    def part(self, cause: str, quantity: str, region: str = "interior") -> Part:
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

    def total(self, quantity: str, region: str = "interior") -> Total:
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

        Columns are the fields of `Part`. Rows of the whole have the causes ``sum``, ``added``, ``everything`` and
        ``ideal``.
        """
        import pandas as pd

        rows = [asdict(one) for one in self.parts]
        for one in self.totals:
            place = {"quantity": one.quantity, "region": one.region, "unit": one.unit, "size": ""}
            rows.append({"cause": "sum", "title": "root of the sum of squares", **place, "figure": one.parts})
            rows.append({"cause": "added", "title": "added up pixel by pixel", **place, "figure": one.added})
            told = {"simulated": one.simulated, "figure": one.simulated, "seen": one.seen}
            rows.append({"cause": "everything", "title": "everything on", **place, **told})
            told = {"simulated": one.ideal, "figure": one.ideal}
            rows.append({"cause": "ideal", "title": "ideal images", **place, **told})
        return pd.DataFrame(rows, columns=list(Part.__dataclass_fields__))

    def words(self, region: str = "interior") -> list[str]:
        """Return what limits and what helps most, a sentence or two for each quantity."""
        return words_of(self.parts, self.totals, self.remedies, region)
