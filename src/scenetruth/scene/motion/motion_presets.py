"""Presets: typical rates of leaf motion and growth, each with its source."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Literal

from scenetruth.validated_model import Preset, preset

__all__ = [
    "FRAME_INTERVAL_S",
    "MOTION_PRESETS",
    "GrowthPreset",
    "ShiftPreset",
    "TurnPreset",
    "fill_in_preset",
    "preset_or_fields",
]

GrowthPreset = Literal["leaf_growth_1_percent", "leaf_growth_3_percent"]
ShiftPreset = Literal["leaf_movement"]
TurnPreset = Literal["leaf_tilt"]

TYPICAL = "typical value, no source available"
"""Source of a preset value without reference."""

FRAME_INTERVAL_S = 60.0
"""Frame interval of presets with rates per frame: one frame per minute."""

_SCHMUNDT = (
    "Schmundt et al. (1998), Quantitative analysis of the local rates of growth of dicot leaves at a high temporal and "
    "spatial resolution, using image sequence analysis, Plant J. 16, 505, abstract"
)
_WIESE = (
    "Wiese et al. (2007), Spatio-temporal leaf growth patterns of Arabidopsis thaliana and evidence for sugar control "
    "of the diel leaf growth cycle, New Phytol. 174, 752, summary"
)
_MODULAR = "The modular character of growth in Nicotiana tabacum plants under steady-state nutrition, abstract"
_CONFORMAL = "Mitchison (2016), Conformal growth of Arabidopsis leaves, J. Theor. Biol. 408, 155, abstract"
_PROFILOMETER = "https://doi.org/10.1038/s42005-021-00626-z (2021), caption of figure 1"
_LIDAR = (
    "Leaf movements of indoor plants monitored by terrestrial LiDAR (2018), Front. Plant Sci. 9, 189, abstract "
    "(Calathea roseopicta)"
)
_MINUTE = "at one frame per minute"


_PATTERN: Mapping[str, tuple[Any, str]] = MappingProxyType(
    {
        "base_to_tip": (
            (1.5, 0.5),
            f"rates decline linearly from the base to the tip: {_MODULAR}; the size: {TYPICAL}",
        ),
        "along_share": (
            0.6,
            f"isotropic growth describes measured displacements to about 90 %: {_CONFORMAL}; the value: {TYPICAL}",
        ),
        "diel_amplitude": (0.5, TYPICAL),
        "peak_h": (6.0, f"highest rates at dawn: {_WIESE}; the hour: {TYPICAL}"),
    }
)

MOTION_PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "leaf_growth_1_percent": preset(
            "1 %/h of a leaf's area",
            rate_per_hour=(0.01, f"growth can be detected at under 1 % per hour: {_SCHMUNDT}"),
            **_PATTERN,
        ),
        "leaf_growth_3_percent": preset(
            "3 %/h of a leaf's area, a fast young leaf",
            rate_per_hour=(
                0.03,
                f"{TYPICAL}; small pieces of a tobacco leaf most often grew 1 % in 15 minutes: {_PROFILOMETER}",
            ),
            **_PATTERN,
        ),
        "leaf_movement": preset(
            "0.1 mm/min",
            distance_mm=(
                {"kind": "linear", "rate_per_frame": 0.1},
                f"{_MINUTE}; leaves moved 36.7 mm in 5.5 h on average, 0.11 mm/min: {_LIDAR}",
            ),
        ),
        "leaf_tilt": preset(
            "0.2°/min",
            angle_deg=(
                {"kind": "linear", "rate_per_frame": 0.2},
                f"{_MINUTE}; the angle of a leaf changed by up to 69.6° in 5.5 h, 0.21°/min: {_LIDAR}",
            ),
        ),
    }
)


def fill_in_preset(given: Any) -> Any:
    """Return the fields of a motion, completed from its preset."""
    name = given.get("preset") if isinstance(given, dict) else None
    if not isinstance(name, str) or name not in MOTION_PRESETS:
        return given
    return {**MOTION_PRESETS[name].values, **given}


def preset_or_fields(*needed: str) -> Callable[[dict[str, Any]], None]:
    """Return a JSON Schema modifier by which a preset replaces the required fields except ``needed``."""

    def change(schema: dict[str, Any]) -> None:
        required = schema.pop("required")
        schema["anyOf"] = [{"required": ["kind", "preset", *needed]}, {"required": required}]

    return change
