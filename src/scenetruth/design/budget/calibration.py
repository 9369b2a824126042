"""How well the camera's calibration is known: standard deviations of what estimates are told of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import ValidationError

from scenetruth.errors import Problem, RecipeError
from scenetruth.model import FrozenModel, NonNegative

__all__ = ["Calibration", "CalibrationGiven", "calibration_of"]


class Calibration(FrozenModel):
    """Standard deviations of the calibration that a recording carries; its images know nothing of them.

    Typical are calibrations with some 20 images of a chessboard. Two that were published with the toolbox of J.-Y.
    Bouguet state 0.05 % of the focal length, and 0.5 and 2.8 px of the principal point (a third of the three standard
    deviations that are printed). A screw stage with an accuracy of 10 µm over a travel of 20 mm has 0.05 % of its
    steps.

    See Also
    --------
    scenetruth.design.budget.budget : Takes it, and tells what it does to depth and motion.

    Examples
    --------
    >>> Calibration()
    Calibration(focal_length_percent=0.05, principal_point_px=1.0, baseline_percent=0.05)

    0.1 % of the focal length is 0.5 mm of depth at a wall 500 mm away:

    >>> from scenetruth.design.budget import budget
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"frames": {"count": 3}, "render": {"backend": "raycast"}, "score": {"interior_margin_px": 0}}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 2.2}, "sensor": {"noise_std": 0.002}}
    >>> known = Calibration(focal_length_percent=0.1, principal_point_px=0, baseline_percent=0.02)
    >>> found = budget(scene, method="structure_tensor", calibration=known, draws=1, confirm=0)
    >>> for cause in ("focal_length", "baseline"):
    ...     part = found.part(cause, "depth")
    ...     print(f"{part.title}, {part.size}: {part.predicted:.2f} {part.unit}")
    focal length, 0.1 %: 0.50 mm
    baseline, 0.02 %: 0.10 mm
    """

    focal_length_percent: NonNegative = 0.05
    """Of the focal length, in % of it."""
    principal_point_px: NonNegative = 1.0
    """Of the principal point, along x and along y, in px."""
    baseline_percent: NonNegative = 0.05
    """Of the scale of the stage's positions, in %."""


CalibrationGiven = Calibration | Mapping[str, float] | Literal["typical", "perfect"]
"""A calibration as a caller gives it."""

_PERFECT = Calibration(focal_length_percent=0, principal_point_px=0, baseline_percent=0)


def calibration_of(given: Any) -> Calibration:
    """Return a calibration; of a mapping, what is not given is perfect.

    Raises
    ------
    RecipeError
        With everything that is wrong with it.
    """
    if isinstance(given, Calibration):
        return given
    if given in ("typical", "perfect"):
        return Calibration() if given == "typical" else _PERFECT
    if not isinstance(given, Mapping):
        message = f"must be 'typical', 'perfect', or a mapping of {', '.join(Calibration.model_fields)}"
        raise RecipeError([Problem("calibration", message, given)], source="an error budget")
    try:
        return Calibration.model_validate({**_PERFECT.model_dump(), **given})
    except ValidationError as error:
        problems = [
            Problem(
                ".".join(["calibration", *map(str, entry["loc"])]),
                f"is unknown; known: {', '.join(Calibration.model_fields)}"
                if entry["type"] == "extra_forbidden"
                else entry["msg"][:1].lower() + entry["msg"][1:],
                entry.get("input"),
            )
            for entry in error.errors(include_url=False)
        ]
        raise RecipeError(problems, source="an error budget") from error
