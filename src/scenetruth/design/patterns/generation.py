"""Generation of a pattern for a rig, with lengths derived from its pixels, and a seed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.design.patterns.pattern_model import Box, Marks, PatternDrawing, PatternModel, validate_values
from scenetruth.design.patterns.pattern_rig import PatternRig
from scenetruth.discovery import kinds_in
from scenetruth.errors import ArgumentError, Problem
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene

__all__ = ["Pattern", "generate_pattern", "list_pattern_types"]

_TYPES_MODULE = "scenetruth.design.patterns.pattern_types"
_BEYOND = 1.1  # default size relative to the field of view, along each axis
# Default lengths in px. Dots of 3 to 5 px are recommended for DIC (iDICs, Good Practices Guide, 2018).
_LENGTHS_PX: dict[str, Any] = {"dot_mm": 4.0, "wavelength_mm": (5.0, 20.0)}
_LEAST_DOTS = 8


@dataclass(frozen=True, eq=False)
class Pattern:
    """A pattern generated for a rig.

    Parameters
    ----------
    model
        Model of the pattern, with all lengths in mm.
    size_mm
        Width and height in mm.
    seed
        Seed of the random pattern.
    rig
        The rig that the pattern is designed for.
    drawing
        Distribution of ink.

    See Also
    --------
    scenetruth.design.patterns.generate_pattern : Generates a pattern.
    scenetruth.design.patterns.export_pattern : Exports it for printing.

    Examples
    --------
    >>> from scenetruth.design.patterns import generate_pattern, PatternRig
    >>> rig = PatternRig.from_scene(focal_length_px=5000, distance_mm=600)
    >>> pattern = generate_pattern(rig, size_mm=(30, 20), seed=1)
    >>> pattern.description
    'dots of 0.480 mm (4.00 px), 50 % covered, centres at least 1 diameters apart'

    Its reflectance, between those of ink and paper, in texels of 0.1 mm:

    >>> grey = pattern.radiance((0, 0, 30, 20), (200, 300))
    >>> f"{grey.min():.2f} to {grey.max():.2f}, in the mean {grey.mean():.2f}"
    '0.05 to 0.85, in the mean 0.45'
    """

    model: PatternModel
    size_mm: tuple[float, float]
    seed: int
    rig: PatternRig
    drawing: PatternDrawing

    @property
    def description(self) -> str:
        """One-line description."""
        return self.model.description(self.rig.mm_per_px)

    def radiance(self, box_mm: Box, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return the mean reflectance of texels, shape (rows, columns).

        Parameters
        ----------
        box_mm
            Left and upper border, width and height of the area of the texels in mm; y points down.
        shape
            Number of rows and columns.
        """
        ink, paper = self.model.radiances
        return np.asarray(paper + (ink - paper) * self.drawing.ink(box_mm, shape), dtype=np.float32)

    def marks(self, box_mm: Box) -> Marks:
        """Return the marks to print in a box."""
        return self.drawing.marks(box_mm)

    def to_dict(self) -> dict[str, Any]:
        """Return the parameters as plain values."""
        return {**self.model.model_dump(mode="json"), "size_mm": list(self.size_mm), "seed": self.seed}


def list_pattern_types() -> dict[str, type[PatternModel]]:
    """Return the models of all pattern types, by name."""
    return kinds_in(PatternModel, _TYPES_MODULE)  # type: ignore[return-value]


def generate_pattern(
    rig: PatternRig | Scene | Mapping[str, Any] | str | Path,
    type: str = "speckle",
    *,
    size_mm: tuple[float, float] | None = None,
    seed: int = 0,
    **settings: Any,
) -> Pattern:
    """Generate a printable pattern for a rig.

    Parameters
    ----------
    rig
        The rig, or a scene, its plain values or file.
    type
        ``"speckle"``: random dots; ``"noise"``: band-limited noise, thresholded to ink and paper; ``"grey_noise"``:
        band-limited noise in shades of grey, for photographic prints.
    size_mm
        Width and height in mm; default: 1.1 times the field of view of the camera, in whole mm.
    seed
        Seed of the random pattern.
    **settings
        Fields of the model of this type. Lengths may be given in px on the sensor: ``dot_px``, ``wavelength_px``
        instead of ``dot_mm``, ``wavelength_mm``. Default: dots of 4 px, noise of 5 to 20 px.

    Returns
    -------
    Pattern
        The generated pattern.

    Raises
    ------
    ArgumentError
        If an argument is invalid; lists all errors.
    SceneError
        If the scene is invalid.

    See Also
    --------
    scenetruth.design.patterns.PatternRig.from_scene : A rig from a scene or from numbers.
    scenetruth.design.patterns.assess_pattern : Assesses a pattern.
    scenetruth.design.patterns.export_pattern : Exports a pattern for printing.

    Examples
    --------
    >>> from scenetruth.design.patterns import generate_pattern, PatternRig
    >>> rig = PatternRig.from_scene(focal_length_px=5000, distance_mm=600)
    >>> generate_pattern(rig, size_mm=(30, 20), seed=1).description
    'dots of 0.480 mm (4.00 px), 50 % covered, centres at least 1 diameters apart'
    """
    rig = rig if isinstance(rig, PatternRig) else PatternRig.from_scene(rig)
    kinds = list_pattern_types()
    if type not in kinds:
        raise ArgumentError([Problem("type", f"must be one of {', '.join(kinds)}", type)], source="a pattern")
    lengths, problems = _in_mm(settings, kinds[type], rig)
    model, found = validate_values(kinds[type], {"kind": type, **lengths})
    problems += found
    size = size_mm or _visible_size_mm(rig)
    problems += _size_problems(size) + ([] if _is_seed(seed) else [_seed_problem(seed)])
    if model is not None and size is not None and not problems:
        if min(size) < _LEAST_DOTS * model.finest_mm:
            message = f"must be at least {_LEAST_DOTS} times {model.finest_mm:.3g} mm along each side"
            problems.append(Problem("size_mm", message, size))
        else:
            problems += model.size_problems(size)
    if model is None or size is None or problems:
        raise ArgumentError(problems, source="a pattern")
    width, height = (float(side) for side in size)
    drawing = model.draw((width, height), generator_for(seed, "pattern", type))
    return Pattern(model, (width, height), seed, rig, drawing)


def _in_mm(
    settings: Mapping[str, Any], model: type[PatternModel], rig: PatternRig
) -> tuple[dict[str, Any], list[Problem]]:
    """Return settings with lengths in mm, and the problems of lengths in px."""
    found, problems = dict(settings), []
    for name in [field for field in _LENGTHS_PX if field in model.model_fields]:
        in_px = name.replace("_mm", "_px")
        if name in found and in_px in found:
            problems.append(Problem(in_px, f"specify either {in_px} or {name}", found.pop(in_px)))
        if name in found:
            continue
        given = found.pop(in_px, _LENGTHS_PX[name])
        try:
            several = isinstance(given, list | tuple)
            found[name] = tuple(float(each) * rig.mm_per_px for each in given) if several else given * rig.mm_per_px
        except (TypeError, ValueError):
            problems.append(Problem(in_px, "must be a number, or several where the length has several", given))
            found[name] = _LENGTHS_PX[name]
    return found, problems


def _visible_size_mm(rig: PatternRig) -> tuple[float, float] | None:
    seen = rig.field_mm
    return None if seen is None else (float(math.ceil(_BEYOND * seen[0])), float(math.ceil(_BEYOND * seen[1])))


def _size_problems(size: Any) -> list[Problem]:
    if size is None:
        return [Problem("size_mm", "is missing: the rig has no image size; specify width and height")]
    try:
        width, height = (float(side) for side in size)
    except (TypeError, ValueError):
        return [Problem("size_mm", "must be width and height in mm", size)]
    if not all(0 < side <= 10_000 for side in (width, height)):
        return [Problem("size_mm", "must be more than 0 and at most 10,000 mm along each side", size)]
    return []


def _is_seed(seed: Any) -> bool:
    return isinstance(seed, int) and not isinstance(seed, bool) and 0 <= seed < 2**63


def _seed_problem(seed: Any) -> Problem:
    return Problem("seed", "must be an integer from 0 to below 2^63", seed)
