"""Cases that vary the light that leaves a surface: gloss, and light that passes a sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np
import xarray as xr

from scenetruth.benchmark.cases.case import METHOD_VALID, BenchmarkRecord, Case, CaseEstimates, Mask
from scenetruth.benchmark.cases.reference_scene import DISTANCE_MM, build_reference_scene, build_wall
from scenetruth.scoring.error_pairs import EstimateTruthPairs

__all__ = ["OUTLYING_STDS"]

OUTLYING_STDS = 6.0
"""Stated standard deviations beyond which an error contradicts its stated uncertainty."""


class LightCase(Case):
    """Base class of these cases, which also evaluate gross contradictions of the stated uncertainty."""

    truth_content = "complete_with_light"
    quantities = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")

    def further_rows(self, found: CaseEstimates) -> Iterable[BenchmarkRecord]:
        """Return the fraction of errors beyond 6 stated standard deviations."""
        region = self.region_at(found.truth.isel(t=0), found.value)
        for label, estimate in found.estimates.items():
            pairs = EstimateTruthPairs(estimate, found.truth)
            for quantity in self.quantities:
                pair = pairs.get(quantity)
                if pair is None or pair.std is None:
                    continue
                with np.errstate(invalid="ignore", divide="ignore"):
                    ratio = np.abs(pair.estimate[0] - pair.truth[0]) / pair.std[0]
                kept = region & np.isfinite(ratio) & (True if pair.full is None else pair.full[0])
                share = float(np.mean(ratio[kept] > OUTLYING_STDS)) if kept.any() else math.nan
                yield BenchmarkRecord(
                    self.kind, found.value, label, quantity, METHOD_VALID, "beyond_6_std", share, unit="1"
                )


_LAMP_MM = 100.0
"""Distance of the lamp from the plane: the highlight is sharper, and slides less, than that of a distant lamp."""
_HIGHLIGHT_PX = 36.0


class GlossCase(LightCase):
    """A glossy plane with a lamp 100 mm before its centre, which moves under its highlight."""

    kind = "gloss"
    title = "Gloss"
    question = "How do highlights that slide over a surface affect the accuracy and the stated uncertainty?"
    varied = "roughness of the surface (n = 1.5)"
    full = (0.1, 0.2, 0.4, 0.6, 1.0)
    headline = ("disparity", "bias")

    def labels(self) -> Mapping[float, str]:
        """Return the names of the levels; the last is without gloss."""
        return {value: f"{value:g}" if value < 1 else "matt" for value in self.full}

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane under the lamp."""
        lamp = {
            "kind": "point",
            "position_mm": [0.0, 0.0, DISTANCE_MM - _LAMP_MM],
            "irradiance": 0.6,
            "reference_distance_mm": _LAMP_MM,
        }
        material = {"refractive_index": 1.5, "roughness": value} if value < 1 else {}
        return build_reference_scene({"objects.0.material": material, "lighting.lights": [lamp]})

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels within 36 px of the image centre, in the highlights of all roughnesses."""
        y, x = np.mgrid[: truth.sizes["y"], : truth.sizes["x"]]
        off = np.hypot(x - (truth.sizes["x"] - 1) / 2, y - (truth.sizes["y"] - 1) / 2)
        return np.asarray(np.isfinite(truth["depth"].values) & (off <= _HIGHLIGHT_PX))


_SHADOW_PX = 6.0


class TranslucencyCase(LightCase):
    """A sheet lit from both sides; a bar behind it casts a shadow that shows through and moves against the sheet."""

    kind = "translucency"
    title = "Translucency"
    question = "How does the shadow of an object behind a sheet affect the accuracy in front?"
    varied = "transmittance of the sheet relative to its texture"
    full = (0.1, 0.3, 0.6)
    headline = ("flow_x", "rmse")
    seeds: ClassVar[Mapping[str, int]] = {"core": 1, "full": 3}

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, the bar behind it, and a lamp on either side."""
        sheet = build_wall() | {"material": {"reflectance": 0.4, "transmittance": value}}
        bar = build_wall("bar", distance_mm=DISTANCE_MM + 40, size_mm=(24, 150), velocity=(-0.3, 0.0, 0.0))
        lamps = [
            {"kind": "directional", "direction": [0, 0, 1], "irradiance": 1.0},
            {"kind": "directional", "direction": [0, 0, -1], "irradiance": 0.6},
        ]
        return build_reference_scene({"objects": [sheet, bar], "lighting.lights": lamps})

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels within 6 px of a border of the shadow."""
        near = truth["shadow_distance"].values <= _SHADOW_PX
        return np.asarray(super().region_at(truth, value) & near)


class PenumbraCase(LightCase):
    """A moving sheet with the shadow of a bar at rest, by the size of the lamp."""

    kind = "penumbra"
    title = "Penumbra"
    question = "How does the sharpness of a shadow that does not move with the surface affect the accuracy?"
    varied = "radius of the lamp, mm; penumbrae are 1.1 times as wide, in px"
    full = (1.0, 5.0, 20.0)
    headline = ("flow_x", "rmse")
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet under the lamp, and the bar outside the field of view of the cameras."""
        bar = build_wall("bar", distance_mm=640.0, size_mm=(12, 300), centre_mm=(-72.0, 0.0), velocity=(0.0, 0.0, 0.0))
        lamp = {
            "kind": "disc",
            "position_mm": [-150.0, 0.0, 500.0],
            "target_mm": [0.0, 0.0, DISTANCE_MM],
            "radius_mm": value,
            "irradiance": 0.9,
            "reference_distance_mm": 250.0,
        }
        lighting = {"ambient": 0.2, "lights": [lamp]}
        return build_reference_scene({"objects": [build_wall(), bar], "lighting": lighting})

    def region_at(self, truth: xr.Dataset, value: float) -> Mask:
        """Return the pixels within 6 px of a border of the shadow, or within its penumbra."""
        near = truth["shadow_distance"].values <= _SHADOW_PX
        return np.asarray(super().region_at(truth, value) & near & (truth["object_id"].values == 0))
