"""A scene in one line, and as a table for notebooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from scenetruth.camera import AnySensor, Camera, Frames, Stage
from scenetruth.scene.item import SceneObject
from scenetruth.scene.lighting import Lighting
from scenetruth.scene.plant import PlantModel

__all__ = ["html_table", "line_of", "rows_of"]


def line_of(description: str, camera: Camera, stage: Stage, frames: Frames, names: Sequence[str]) -> str:
    """Return one line that tells what a scene is for, how many images of which size it has, and of what."""
    grid = f"{stage.rows} x " if stage.rows > 1 else ""
    parts = [
        *([repr(description)] if description else []),
        f"{camera.width} x {camera.height} px",
        f"{grid}{stage.positions} positions x {frames.count} frames",
        f"objects: {', '.join(names)}",
    ]
    return f"Scene({'; '.join(parts)})"


def rows_of(
    camera: Camera,
    stage: Stage,
    frames: Frames,
    things: Sequence[SceneObject | PlantModel],
    lighting: Lighting,
    sensor: AnySensor,
) -> dict[str, str]:
    """Return what a scene consists of: headings and texts."""
    lens = "" if camera.distortion is None else ", with distortion"
    rows = f"{stage.rows} rows, {stage.row_spacing_mm:g} mm apart, of " if stage.rows > 1 else ""
    unequal = "" if stage.positions_mm is None else " in the mean"
    return {
        "camera": f"{camera.width} x {camera.height} px, f = {camera.focal_px:g} px{lens}",
        "stage": f"{rows}{stage.positions} positions, {stage.baseline_mm:g} mm apart{unequal}",
        "frames": f"{frames.count}, {frames.frame_interval_s:g} s apart",
        **{f"{_noun(thing)} '{thing.name}'": _text_of(thing) for thing in things},
        "light": _light(lighting),
        "sensor": _sensor(sensor),
    }


def html_table(caption: str, rows: Mapping[str, str]) -> str:
    """Return a table in HTML of headings and texts."""
    lines = "".join(f"<tr><th>{escape(head)}</th><td>{escape(text)}</td></tr>" for head, text in rows.items())
    return f"<table><caption>{escape(caption)}</caption><tbody>{lines}</tbody></table>"


def _noun(thing: SceneObject | PlantModel) -> str:
    return "plant" if isinstance(thing, PlantModel) else "object"


def _text_of(thing: SceneObject | PlantModel) -> str:
    shape = (
        f"{_plant_kind(thing)} of {len(thing.places())} leaves" if isinstance(thing, PlantModel) else thing.mesh.kind
    )
    growth = [thing.growth] if isinstance(thing, PlantModel) and thing.growth is not None else []
    parts = {
        "": shape,
        "texture ": thing.texture.kind,
        "deformation ": ", ".join(item.kind for item in (*growth, *thing.deformation)),
        "motion ": ", ".join(item.kind for item in thing.motion),
    }
    return "; ".join(f"{name}{text}" for name, text in parts.items() if text)


def _plant_kind(plant: PlantModel) -> str:
    return str(getattr(plant, "kind", "plant"))


def _light(lighting: Lighting) -> str:
    if not lighting.lit:
        return "unlit: radiance is the textures'"
    ambient = [] if lighting.ambient is None else [f"ambient {lighting.ambient:g}"]
    return ", ".join([*ambient, *(light.kind for light in lighting.lights)])


def _sensor(sensor: AnySensor) -> str:
    if isinstance(sensor, str):
        return sensor
    preset = getattr(sensor, "preset", None)
    bits = getattr(sensor, "bit_depth", None)
    effects = ", ".join(effect.kind for effect in getattr(sensor, "effects", ()))
    parts = [sensor.kind, preset or "", effects, f"{bits} bits" if bits is not None else ""]
    return "; ".join(filter(None, parts))
