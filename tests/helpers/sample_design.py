"""A small design, made by hand: a sheet before a stage, two objectives, five rigs, three of them simulated."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pandas as pd

from scenetruth.design.optimisation import (
    ConstraintValue,
    DesignResult,
    Discrepancy,
    Objective,
    PredictionInterval,
    RigDesign,
    RuleOfThumb,
    Sensitivity,
    check_rank_consistency,
)

DEPTH, GROWTH = "depth of object_sheet", "growth of object_sheet"
NUMBERS = (311, 87, 1204, 530, 642)
BASELINES = (4.0, 6.0, 8.0, 12.0, 16.0)


def scene(baseline_mm: float = 8.0, positions: int = 5) -> dict[str, Any]:
    """Return a scene as plain values: a sheet that turns and bulges, before a backdrop."""
    return {
        "description": "A sheet that grows",
        "camera": {"width": 320, "height": 240, "focal_length_mm": 25.0, "pixel_pitch_um": 7.8},
        "optics": {"defocus": {"aperture_mm": 4.5, "focus_distance_mm": 615}},
        "stage": {"positions": positions, "baseline_mm": baseline_mm},
        "frames": {"count": 5, "frame_interval_s": 900},
        "objects": [
            {
                "name": "sheet",
                "mesh": {"kind": "plane", "size_mm": [40, 30]},
                "pose": {
                    "position_mm": [2, 0, 600],
                    "rotations": [{"axis": [0, 1, 0], "angle_deg": 25}],
                },
                "texture": {"kind": "noise", "wavelength_mm": [0.8, 4.0]},
                "deformation": [{"kind": "growth", "rate_per_hour": 0.01}],
            },
            {
                "name": "backdrop",
                "mesh": {"kind": "box", "size_mm": [90, 70, 12]},
                "pose": {"position_mm": [0, 0, 650]},
                "texture": {"kind": "uniform"},
            },
        ],
        "sensor": {"bit_depth": 12, "noise_std": 0.004},
        "seed": 5,
    }


def rig(place: int) -> RigDesign:
    """Return one of five rigs: longer baselines know depth better and growth worse; each second one is simulated."""
    baseline = BASELINES[place]
    depth, growth = 0.4 / baseline, 0.05 * baseline**0.75
    figures = {
        DEPTH: PredictionInterval(1.06 * depth, 0.95 * depth, 1.2 * depth, 6),
        GROWTH: PredictionInterval(1.3 * growth, 1.1 * growth, 1.5 * growth, 6),
    }
    scatter = (0.93, 1.06, 0.97, 1.02, 1.05, 0.97)
    by_seed = {
        title: {
            "scaled_median_abs_error": tuple(one * figures[title].value for one in scatter),
            "rmse": tuple(more * one * figures[title].value for one in scatter),
        }
        for title, more in ((DEPTH, 1.2), (GROWTH, 2.0))
    }
    is_simulated = place % 2 == 0
    constraints = (
        ConstraintValue("field_of_view", "field of view along x", 59.9, 55.0, "mm", True, 4.9 / 55, "at least"),
        ConstraintValue("time_per_capture", "time per capture", 3.5 + place, 8.0, "s", True, (4.5 - place) / 8.0),
        ConstraintValue("motion_blur", "motion blur", 0.002, 0.1, "px", True, 0.98),
        ConstraintValue(
            "stage_travel", "stage travel", 4 * baseline, 50.0, "mm", baseline < 12.5, 1 - 4 * baseline / 50
        ),
    )
    return RigDesign(
        NUMBERS[place],
        {"stage.baseline_mm": baseline, "frames.frame_interval_s": 900, "lens": "typical 25 mm, f/2.8"},
        scene(baseline),
        {DEPTH: depth, GROWTH: growth},
        figures if is_simulated else {},
        constraints,
        1450.0 + 100 * place,
        "Noise of the images limits both; at 20 % more light growth would be known 9 % better.",
        by_seed if is_simulated else {},
    )


def design(folder: Path | None = None) -> DesignResult:
    """Return the design: the third rig is recommended."""
    rigs = [rig(place) for place in range(5)]
    objectives = (
        Objective("depth", "object_sheet", "mm", DEPTH),
        Objective("growth_rate", "object_sheet", "%/h", GROWTH, 0.3),
    )
    rows = []
    for number in range(1300):
        baseline = 2 + 28 * ((0.618 * number) % 1)
        spread = 1 + 2 * ((0.414 * number) % 1)
        rows.append(
            {
                "stage.baseline_mm": baseline,
                "frames.frame_interval_s": (60, 300, 900)[number % 3],
                "lens": "typical 25 mm, f/2.8",
                DEPTH: 0.4 / baseline * spread,
                GROWTH: 0.05 * baseline**0.75 * spread,
                "holds": baseline < 12.5,
                "excess": max(0.0, baseline - 12.5),
                "phase": "sobol",
            }
        )
    best = rigs[2]
    discrepancies = tuple(
        Discrepancy(
            one.number,
            title,
            one.predicted[title],
            one.simulated[title],
            one.simulated[title].value / one.predicted[title],
            title == GROWTH,
            "agrees within its interval" if title == DEPTH else "simulation is 25 % worse than predicted",
        )
        for one in rigs
        if one.is_confirmed
        for title in (DEPTH, GROWTH)
    )
    sensitivities = (
        Sensitivity("stage.baseline_mm", DEPTH, 0.9, 0.2, 0.61, 0.72, -0.091, 0.111, 0.2, 0.2, 64),
        Sensitivity("frames.frame_interval_s", DEPTH, 0.01, 0.0, 0.001, 0.004, 0.0, 0.0, 0.004, 0.006, 64),
        Sensitivity("lens", DEPTH, 0.4, 0.2, 0.2, 0.3, math.nan, math.nan, 0.1, 0.1, 64),
        Sensitivity("stage.baseline_mm", GROWTH, 0.5, 0.3, 0.2, 0.31, 0.074, -0.076, 0.1, 0.2, 64),
        Sensitivity("frames.frame_interval_s", GROWTH, 1.9, 0.3, 0.6, 0.7, -0.0909, 0.111, 0.2, 0.2, 64),
        Sensitivity("lens", GROWTH, 0.2, 0.2, -0.03, 0.1, math.nan, math.nan, 0.2, 0.3, 64),
    )
    rules = (
        RuleOfThumb(
            "speckle size",
            "iDICs, A Good Practices Guide for Digital Image Correlation, 2018",
            "speckles of 3 to 5 px",
            "a mean wavelength of 8.4 px, as of speckles of 4.2 px",
            True,
        ),
        RuleOfThumb(
            "stereo angle",
            "iDICs, A Good Practices Guide for Digital Image Correlation, 2018",
            "cameras 15 to 35 degrees apart",
            "3.1 degrees between the outermost positions",
            False,
        ),
    )
    spec = {
        "title": "Growth of a sheet",
        "scene": "sheet.yaml",
        "variables": {
            "stage.baseline_mm": {"from": 2, "to": 30, "log": True},
            "frames.frame_interval_s": {"values": [60, 300, 900]},
            "lens": ["typical 25 mm, f/2.8"],
        },
        "constraints": [
            {"kind": "depth_of_field", "blur_px": 0.8, "min": 20},
            {"kind": "stage_travel", "max": 50},
        ],
        "objectives": [{"quantity": "depth"}, {"quantity": "growth_rate", "target": 0.3}],
    }
    return DesignResult(
        spec,
        "Growth of a sheet at 1 % per hour",
        objectives,
        best,
        tuple(rigs),
        pd.DataFrame(rows),
        sensitivities,
        rules,
        ("The texture is as the scene has it.", "Images are cut to 160 px for simulations."),
        discrepancies,
        folder,
        {"predictions": 61.2, "simulations": 240.0},
        orders=check_rank_consistency(rigs, objectives),
    )
