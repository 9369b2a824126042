"""Scenes that tests share: small, and written in Python."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

from scenetruth.scene import Scene, load_scene
from scenetruth.scene.leaf import LeafTexture
from tests.helpers.nightly import NIGHTLY

SCENES = Path(__file__).parents[2] / "scenes"
LIBRARY = sorted(SCENES.glob("*.yaml"))
"""All scenes of the library."""
SMALL_CUBE: dict[str, Any] = {
    "camera": {"width": 96, "height": 72, "focal_length_px": 750},
    "frames": {"count": 5},
    "estimate": {"working_point_px": 6},
}
"""Changes of `cube` for runs through all stages."""
FIGURES = None if NIGHTLY else ("image",)
"""Figures of the run that tests share: all of them by night."""


def small(file: Path, parts: int = 4, **changes: Any) -> Scene:
    """Return a scene of the library with a smaller image, ideal, and textures that are soon made."""
    scene = load_scene(file)
    camera = scene.camera
    plants = [
        f"plants.{index}.texture.texels_per_mm={4.01 / plant.texture.mottling_wavelength_mm[0]}"
        for index, plant in enumerate(scene.plants)
        if isinstance(plant.texture, LeafTexture)
    ]
    objects = [f"objects.{index}.texture={{kind: uniform}}" for index in range(len(scene.objects))]
    size = {"width": camera.width // parts, "height": camera.height // parts}
    lens = {"focal_length_px": camera.focal_px / parts, "focal_length_mm": "null", "pixel_pitch_um": "null"}
    values = [f"camera.{name}={value}" for name, value in {**size, **lens}.items()]
    more = [f"{name.replace('__', '.')}={value}" for name, value in changes.items()]
    return load_scene(file, overrides=[*values, *plants, *objects, "sensor=ideal", *more])


def cube(**changes: Any) -> Scene:
    """Return the cube of scenes/cube.yaml at a quarter of its size in pixels, ideal, ray cast."""
    plain: dict[str, Any] = {
        "camera": {"width": 160, "height": 120, "focal_length_px": 1254},
        "stage": {"positions": 5, "baseline_mm": 5.0},
        "frames": {"count": 9},
        "objects": [
            {
                "name": "cube",
                "mesh": {"kind": "box", "size_mm": [49, 49, 49]},
                "pose": {
                    "position_mm": [0, 0, 692.56],
                    "rotations": [{"axis": [0, 1, 0], "angle_deg": 45}, {"axis": [1, 0, 0], "angle_deg": 20}],
                },
                "texture": {"kind": "noise", "wavelength_mm": [3.2, 12.0]},
                "motion": [{"kind": "velocity", "velocity_mm_per_frame": [0.1, -0.05, -1]}],
            }
        ],
        "render": {"backend": "raycast", "supersampling": 2},
        "seed": 7,
    }
    return Scene.from_dict(plain | changes)


def plaid(wavelength_px: float, velocity: tuple[float, float, float], **changes: Any) -> Scene:
    """Return the paper's pattern (eq. 13) with f = 10, Z0 = 100, V_X = 1."""
    phase = changes.pop("phase_deg", (0.0, 0.0))
    baseline = changes.pop("baseline_mm", 1.0)
    plain: dict[str, Any] = {
        "camera": {"width": 64, "height": 64, "focal_length_px": 10},
        "stage": {"positions": 5, "baseline_mm": baseline},
        "frames": {"count": 9},
        "objects": [
            {
                "name": "plaid",
                "mesh": {"kind": "plane", "size_mm": [4000, 4000]},
                "pose": {"position_mm": [0, 0, 100]},
                "texture": {"kind": "plaid", "wavelength_mm": [10 * wavelength_px] * 2, "phase_deg": phase},
                "motion": [{"kind": "velocity", "velocity_mm_per_frame": velocity}],
            }
        ],
        "render": {"backend": "raycast", "supersampling": 1},
        "estimate": {"working_point_px": 0},
    }
    return Scene.from_dict(plain | changes)


IES = "IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 2 1 1 2 0 0 0 1 1 10\n0 90\n0\n100 50\n"


def bright_scene(folder: Path) -> dict[str, Any]:
    """Return a scene with two bands, three lamps, and objects of which each has a value that could be wrong."""

    def lamp(**fields: Any) -> dict[str, Any]:
        return {**fields, "irradiance": {"red": 1.0, "nir": 0.5}, "reference_distance_mm": 300}

    (folder / "lamp.ies").write_text(IES)
    (folder / "none.ies").write_text("no lamp")
    sheet = {"mesh": {"kind": "plane", "size_mm": [40, 40]}, "texture": {"kind": "uniform", "radiance": 0.4}}
    places = {"box": [-60, 0, 420], "varnish": [60, 0, 430], "foil": [0, -50, 440], "leaf": [0, 50, 450]}
    objects = [{"name": name, **deepcopy(sheet), "pose": {"position_mm": place}} for name, place in places.items()]
    objects[0]["mesh"] = {"kind": "box", "size_mm": [40, 40, 40]}
    objects[1]["material"] = {"refractive_index": 1.5}
    objects[2]["material"] = {"roughness": 0.3, "refractive_index": 1.4}
    objects[3] |= {"material": {"transmittance": {"red": 0.1, "nir": 0.8}}, "tint": {"red": 0.4, "nir": 1.0}}
    return {
        "camera": {"width": 64, "height": 48, "focal_length_px": 90, "bands": ["red", "nir"]},
        "stage": {"positions": 3, "baseline_mm": 2},
        "frames": {"count": 2},
        "objects": objects,
        "lighting": {
            "lights": [
                lamp(kind="point", position_mm=[0, -200, 0]),
                lamp(kind="sphere", position_mm=[100, 0, 0], radius_mm=5),
                lamp(kind="ies", file=str(folder / "lamp.ies"), position_mm=[0, -100, 0], direction=[0, 0, 1]),
            ]
        },
        "estimate": {"method": "structure_tensor"},
    }
