"""Words for design variables, in place of the names of their fields."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from scenetruth.number_format import format_value

__all__ = ["describe_parameter", "label_parameter", "parameter_unit", "title_parameter", "title_parameters"]

_NUMBERS = ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"]
_COUNTED = {
    "frames.count": ("frame", "frames"),
    "stage.positions": ("stage position", "stage positions"),
    "stage.rows": ("row of positions", "rows of positions"),
}
_TITLES = {
    "camera.focal_length_mm": "focal length",
    "camera.focal_length_px": "focal length",
    "camera.height": "image height",
    "camera.width": "image width",
    "estimate.method": "method",
    "exposure_s": "exposure time",
    "f_number": "f-number",
    "frames.count": "number of frames",
    "frames.frame_interval_s": "frame interval",
    "lens": "focal length of the lens",
    "sensor.noise_std": "sensor noise",
    "stage.baseline_mm": "baseline",
    "stage.positions": "number of stage positions",
    "stage.rows": "number of rows of positions",
    "working_distance_mm": "working distance",
}
_UNITS = {
    "deg": "°",
    "frames": "frames",
    "h": "h",
    "hz": "Hz",
    "lux": "lux",
    "mm": "mm",
    "nm": "nm",
    "per_hour": "per hour",
    "px": "px",
    "s": "s",
    "um": "µm",
    "urad": "µrad",
}
_OF = {"sensor.noise_std": "of full scale"}
"""Units of variables whose names have none."""
_SYMBOLS = {"sigma": "σ"}
_UNIT = re.compile(rf"_({'|'.join(sorted(_UNITS, key=len, reverse=True))})$")


def title_parameter(path: str) -> str:
    """Return the title of a design variable; of other fields, the last words of the path, without the unit.

    >>> title_parameter("f_number"), title_parameter("stage.baseline_mm"), title_parameter("lens")
    ('f-number', 'baseline', 'focal length of the lens')
    >>> title_parameter("objects.0.texture.wavelength_mm"), title_parameter("estimate.window_sigma_px")
    ('texture wavelength', 'window σ')
    """
    if path in _TITLES:
        return _TITLES[path]
    keys = [key for key in path.split(".") if key != "*" and not key.lstrip("-").isdigit()]
    words = _UNIT.sub("", "_".join(keys[-2:]).removeprefix("estimate_")).split("_")
    return " ".join(_SYMBOLS.get(word, word) for word in words)


def parameter_unit(path: str) -> str:
    """Return the unit in the name of a design variable; empty without one.

    >>> parameter_unit("stage.baseline_mm"), parameter_unit("f_number")
    ('mm', '')
    """
    unit = _UNIT.search(path)
    return _OF.get(path, "") if unit is None else _UNITS[unit[1]]


def label_parameter(path: str) -> str:
    """Return the title of a design variable with its unit, for an axis.

    >>> label_parameter("stage.baseline_mm"), label_parameter("f_number")
    ('baseline, mm', 'f-number')
    """
    unit = parameter_unit(path)
    return f"{title_parameter(path)}, {unit}" if unit else title_parameter(path)


def title_parameters(paths: Sequence[str]) -> dict[str, str]:
    """Return the titles of several variables; those with the same title as another have their paths.

    >>> title_parameters(["stage.baseline_mm", "objects.0.texture.mean", "objects.1.texture.mean"])["stage.baseline_mm"]
    'baseline'
    >>> title_parameters(["objects.0.texture.mean", "objects.1.texture.mean"])["objects.1.texture.mean"]
    'objects.1.texture.mean'
    """
    titles = [title_parameter(path) for path in paths]
    return {path: title if titles.count(title) == 1 else path for path, title in zip(paths, titles, strict=True)}


def describe_parameter(path: str, value: Any, text: str | None = None, title: str | None = None) -> str:
    """Return a design variable and its value in words.

    ``text``, ``title``: Text of the value, and title of the variable, in place of the defaults.

    >>> describe_parameter("f_number", 2.0), describe_parameter("stage.positions", 9)
    ('f-number 2', 'nine stage positions')
    >>> describe_parameter("stage.baseline_mm", 8.845), describe_parameter("frames.count", 17)
    ('baseline 8.845 mm', '17 frames')
    >>> describe_parameter("sensor.noise_std", 0.005)
    'sensor noise 0.005 of full scale'
    """
    if path in _COUNTED and isinstance(value, int) and not isinstance(value, bool):
        number = _NUMBERS[value] if 0 <= value < len(_NUMBERS) else str(value)
        return f"{number} {_COUNTED[path][value != 1]}"
    unit = parameter_unit(path)
    text = f"{title or title_parameter(path)} {text or format_value(value)}"
    return f"{text}{'' if unit == '°' else ' '}{unit}".rstrip()
