"""Settings of a method in words: names and units from the descriptions of the fields of its settings model."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, get_args

import yaml
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from scenetruth.errors import EstimateError
from scenetruth.number_format import flatten, humanise
from scenetruth.validated_model import field_docstrings

__all__ = ["MethodSettingsTable", "SettingRow", "describe_settings", "name_setting"]


@dataclass(frozen=True)
class SettingRow:
    """A setting: name in words, value with unit, key in files, description, and the default if it is another value."""

    name: str
    value: str
    key: str
    description: str = ""
    default: str = ""


@dataclass(frozen=True)
class MethodSettingsTable:
    """The settings of an estimate in words, and as the section of a scene file."""

    rows: list[SettingRow]
    text: str


def describe_settings(method: str, settings: Mapping[str, Any]) -> MethodSettingsTable | None:
    """Return the settings of a method in words; None without settings.

    Names, units and descriptions are those of the settings model of an installed method. Keys of other methods, and
    unknown keys, are written with spaces.

    >>> table = describe_settings("structure_tensor", {"window_sigma_px": 4.0, "tau": "auto"})
    >>> for row in table.rows:
    ...     print(f"{row.key}: {row.name}, {row.value} (default: {row.default})".replace(chr(0xA0), " "))
    window_sigma_px: Standard deviation of the Gaussian window B in x and y, 4 px (default: 6 px)
    tau: Threshold τ below which an eigenvalue of the structure tensor counts as zero, auto (default: 0.0012)
    >>> print(table.text)
    estimate:
      method: structure_tensor
      window_sigma_px: 4.0
      tau: auto
    """
    if not settings:
        return None
    fields = {"method": method, **settings} if method else dict(settings)
    text = yaml.safe_dump({"estimate": fields}, sort_keys=False, allow_unicode=True, width=100).strip()
    return MethodSettingsTable(list(_rows(settings, _settings_model(method), "", "")), text)


def _settings_model(method: str) -> type[BaseModel] | None:
    """Return the settings model of an installed method; code of other files is not imported."""
    from scenetruth.estimators import find_method, list_methods

    if method not in {entry.name for entry in list_methods() if not entry.problem}:
        return None
    try:
        return find_method(method).settings
    except EstimateError:
        return None


def _rows(settings: Mapping[str, Any], model: type[BaseModel] | None, prefix: str, within: str) -> Iterator[SettingRow]:
    texts = {} if model is None else field_docstrings(model)
    fields = {} if model is None else model.model_fields
    for key, value in settings.items():
        name, unit = name_setting(key, texts.get(key, ""))
        path, title = f"{prefix}{key}", f"{within}: {name[0].lower()}{name[1:]}" if within else name
        if isinstance(value, Mapping) and value:
            yield from _rows(value, _model_within(fields[key].annotation) if key in fields else None, f"{path}.", title)
            continue
        default = fields[key].get_default(call_default_factory=True) if key in fields else value
        differs = json.dumps(default, default=str) != json.dumps(value, default=str)
        shown = _with_unit(default, unit) if differs and default is not PydanticUndefined else ""
        yield SettingRow(title, _with_unit(value, unit), path, _plain(texts.get(key, "")), shown)


def _with_unit(value: Any, unit: str) -> str:
    """Return the text of a value, and the unit of numbers."""
    text = "none" if value is None else flatten(value).replace("_", " ") if isinstance(value, str) else flatten(value)
    unit = "frame" if (value, unit) == (1, "frames") else unit
    has_unit = isinstance(value, int | float | list | tuple) and not isinstance(value, bool)
    return f"{text}{'' if unit == '°' else chr(0xA0)}{unit}" if unit and has_unit else text


def _model_within(annotation: Any) -> type[BaseModel] | None:
    """Return the first model of the types of a field."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _model_within(part)) is not None), None)


_UNITS = {"px": "px", "mm": "mm", "s": "s", "deg": "°", "frames": "frames", "dn": "DN", "urad": "µrad", "ppm": "ppm"}
_STATED_UNIT = re.compile(r"(?:, | in |, in )(px|mm|DN|frames|grey values)(?: per (frame|step of s))?(?=$|[,.;:])")
_END = re.compile(r"[.;:](?:\s|$)|, which\b|, and the\b|, for grey values\b|, odd\b")


def name_setting(key: str, description: str = "") -> tuple[str, str]:
    """Return the name of a setting in words, and its unit: from its description, else from its key.

    >>> name_setting("max_motion_px", "Largest image motion in px per frame, as a prior. Default: none.")
    ('Largest image motion, as a prior', 'px/frame')
    >>> name_setting("window_px", "Width of the window in which it is searched for."), name_setting("half_angle_deg")
    (('Width of the window in which it is searched for', 'px'), ('Half angle', '°'))
    """
    suffix = "DN/e⁻" if key.endswith("_dn_per_e") else _UNITS.get(key.rpartition("_")[2], "")
    first = _plain(_END.split(" ".join(description.split()), maxsplit=1)[0])
    if not first:
        words = humanise(key).partition(" [")[0].removesuffix(f" {key.rpartition('_')[2]}" if suffix else "")
        return f"{words[0].upper()}{words[1:]}", suffix
    stated = _STATED_UNIT.search(first)
    if stated is not None:
        unit = _UNITS["dn"] if stated[1] == "grey values" else stated[1]
        suffix = f"{unit}/{stated[2].partition(' ')[0]}" if stated[2] else unit
        first = first.replace(stated[0], "", 1)
    return first, suffix


def _plain(text: str) -> str:
    """Return a description without the marks of code."""
    return " ".join(text.replace("`", "").split())
