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
