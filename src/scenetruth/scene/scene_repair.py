"""Valid remainder of an invalid scene, which shows the problems that its errors would hide."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from scenetruth.camera import Camera
from scenetruth.scene.material import MATT
from scenetruth.scene.scene_models import Scene
from scenetruth.scene.texture.procedural_textures import UniformTexture
from scenetruth.valid_remainder import Keys, Repair, copied, find_hidden_errors, is_item

__all__ = ["SceneRemainder", "find_remainder"]

_GLOSS = ("refractive_index", "roughness", "roughness_along", "metallic")
_COLOURS = ("texture", "tint", "material")
# Without an effect on any other problem: all that is in front of the camera is in its images.
_CAMERA: dict[str, Any] = {"width": 64, "height": 48, "focal_length_px": 1e-3}
_STAGE = {"positions": 1, "baseline_mm": 1.0}
_FRAMES = {"count": 1, "frame_interval_s": 60.0}
_LAMP = {"kind": "directional", "direction": [0, 0, 1]}
_PLANE = {"kind": "plane", "size_mm": [1, 1]}
_LEAF = {"kind": "rosette", "position_mm": [0, 0, 1000], "leaf": {"kind": "leaf", "length_mm": 10}, "leaves": 1}
_PLACE = {"pose": {"position_mm": [0, 0, 1000]}}
_FAR_MM = 1e6
_NEUTRAL = {"tint": 1.0, "reflectance": 0.0, "transmittance": 0.0, "irradiance": 1.0}


@dataclass(frozen=True, eq=False)
class SceneRemainder:
    """A valid scene in place of an invalid one.

    Fields with errors have values that cause no problem. ``shapeless``: Paths of objects and plants (``objects.0``)
    whose shape or motion has errors.
    """

    scene: Scene
    shapeless: frozenset[str]


def find_remainder(
    plain: Mapping[str, Any],
    error: ValidationError,
    validate: Callable[[Mapping[str, Any]], Scene],
    keys_of: Callable[[Mapping[str, Any], ErrorDetails], list[str]],
) -> tuple[SceneRemainder | None, list[tuple[Mapping[str, Any], list[ErrorDetails]]]]:
    """Return the valid remainder of a scene, None if there is none, and the errors that become visible with it."""
    repair = _Repair(plain)
    scene, found = find_hidden_errors(repair, error, validate, keys_of)
    if scene is None:
        return None, found
    return SceneRemainder(repair.finished(scene), frozenset(repair.shapeless)), found


class _Repair(Repair):
    """Values of a scene, in which fields with errors are removed or replaced."""

    def __init__(self, plain: Mapping[str, Any]) -> None:
        super().__init__(plain)
        self.shapeless: set[str] = set()
        self.colourless: set[str] = set()
        self.textureless: set[str] = set()
        self.bands_known = True
        self.camera_known = True

    def apply(self, keys: Keys, error: str) -> None:
        """Remove or replace a field with an error, and the fields whose check depends on it."""
        self.done.add((error, *keys))
        match keys:
            case []:
                return
            case ["camera", *rest]:
                self._replace_camera(rest)
            case ["stage", *_]:
                self.plain["stage"] = dict(_STAGE)
            case ["frames", *_]:
                self._replace_frames()
            case ["lighting", "lights", index, *rest]:
                self._repair_lamp(index, rest)
            case ["lighting", name, *_] if isinstance(self.plain.get("lighting"), dict):
                # Drift and flicker determine the brightness together.
                self._remove("lighting", "drift_per_frame", "flicker", name)
            case ["objects" | "plants" as group, index, *rest] if is_item(self.plain.get(group), index):
                self._repair_item(group, int(index), rest)
            case ["objects" | "plants" as group, *_]:
                self._repair_list(group)
            case [name, *_]:
                self.plain.pop(name, None)

    def is_shown(self, keys: Keys, error: str) -> bool:
        """Return whether an error that follows a repair is one of the scene as it was given."""
        del keys
        return error != "bands" or self.bands_known

    def finished(self, scene: Scene) -> Scene:
        """Return the scene with matt surfaces in place of those whose texture, tint or material has errors.

        Textures without errors remain.
        """
        objects, plants = list(scene.objects), list(scene.plants)
        matt: dict[str, Any] = {"tint": 1.0, "material": MATT}
        for path in self.colourless | self.textureless:
            group, index = path.split(".")
            if group == "objects":
                plain = {"texture": UniformTexture(kind="uniform")} if path in self.textureless else {}
                objects[int(index)] = objects[int(index)].model_copy(update=matt | plain)
            else:
                plants[int(index)] = plants[int(index)].model_copy(update=matt)
        camera = scene.camera if self.camera_known else Camera(**_CAMERA, bands=scene.camera.bands)
        found = scene.model_copy(update={"camera": camera, "objects": tuple(objects), "plants": tuple(plants)})
        found.__dict__.pop("parts", None)
        return found

    def _remove(self, group: str, *names: str) -> None:
        for name in names:
            self.plain[group].pop(name, None)

    def _replace_camera(self, rest: Keys) -> None:
        given, self.camera_known = self.plain.get("camera"), False
        self.plain.pop("optics", None)
        if isinstance(given, dict) and rest in (["width"], ["height"]) and given.get(rest[0]) != 1:
            # The smallest image has the fewest problems.
            given[rest[0]] = 1
            return
        bands = given.get("bands") if isinstance(given, dict) else None
        # An unknown key may be misspelt bands.
        unknown = {*given} - {*Camera.model_fields} if isinstance(given, dict) else {"camera"}
        if rest[:1] == ["bands"] or (bands is None and unknown):
            self.bands_known, bands = False, None
        self.plain["camera"] = {**_CAMERA, **({} if bands is None else {"bands": bands})}

    def _replace_frames(self) -> None:
        stage = self.plain.get("stage")
        self.plain["stage"] = stage if isinstance(stage, dict) else dict(_STAGE)
        for name in ("time_per_position_s", "poses"):
            # Their number and duration depend on the frames.
            self.plain["stage"].pop(name, None)
        self.plain["frames"] = dict(_FRAMES)
        self.plain.pop("shutter", None)

    def _repair_lamp(self, index: str, rest: Keys) -> None:
        lamps = self.plain["lighting"]["lights"]
        if not is_item(lamps, index):
            self.plain["lighting"]["lights"] = []
            return
        lamp = lamps[int(index)]
        match rest:
            case ["irradiance", *inside] if isinstance(lamp, dict):
                _replace_value(lamp, "irradiance", inside)
            case ["reference_distance_mm"] if lamp.get("reference_distance_mm") != _FAR_MM:
                lamp["reference_distance_mm"] = _FAR_MM
            case ["file"] if "position_mm" in lamp and lamp.get("kind") != "point":
                # The position is given without the file.
                names = ("position_mm", "irradiance", "reference_distance_mm", "motion")
                lamps[int(index)] = {"kind": "point", **{name: lamp[name] for name in names if name in lamp}}
            case _:
                irradiance = lamp.get("irradiance", 1.0) if isinstance(lamp, dict) else 1.0
                lamps[int(index)] = {**_LAMP, "irradiance": irradiance}

    def _repair_item(self, group: str, index: int, rest: Keys) -> None:
        items, path = self.plain[group], f"{group}.{index}"
        item = items[index]
        if not isinstance(item, dict):
            item = items[index] = {}
        match rest:
            case ["material", name, *_] if name in _GLOSS:
                item["material"].pop(name, None)
            case ["name"]:
                # Textures depend on the name.
                item["name"] = self._unused_name(path)
                self.textureless.add(path)
            case ["texture", "textures", band, *_] if _has_band(item["texture"], band):
                item["texture"]["textures"][band] = {"kind": "uniform"}
                self.textureless.add(path)
            case ["texture", *_]:
                self.textureless.add(path)
                item.pop("texture", None)
                if group == "objects":
                    item["texture"] = {"kind": "uniform"}
            case ["tint", *inside]:
                self.colourless.add(path)
                _replace_value(item, "tint", inside)
            case ["material", "reflectance" | "transmittance" as name, *inside]:
                self.colourless.add(path)
                _replace_value(item["material"], name, inside)
            case ["material", *_]:
                self.colourless.add(path)
                item.pop("material", None)
            case _:
                self.shapeless.add(path)
                kept = {name: item[name] for name in ("name", *_COLOURS) if name in item}
                shape = {"mesh": _PLANE, "texture": {"kind": "uniform"}, **_PLACE} if group == "objects" else _LEAF
                items[index] = {**copied(shape), "name": self._unused_name(path), **kept}

    def _repair_list(self, group: str) -> None:
        """Repair a list that is none, has names twice, or is empty."""
        if not isinstance(self.plain.get(group), list):
            self.plain[group] = []
        seen: set[Any] = set()
        for part in ("objects", "plants"):
            items = self.plain.get(part)
            for index, item in enumerate(items if isinstance(items, list) else ()):
                name = item.get("name") if isinstance(item, dict) else None
                if isinstance(name, str) and name in seen:
                    item["name"] = self._unused_name(f"{part}.{index}")
                    self.textureless.add(f"{part}.{index}")
                elif isinstance(name, str):
                    seen.add(name)
        if not seen and not self.plain.get("objects") and not self.plain.get("plants"):
            self.plain["objects"] = [{"name": "objects", "mesh": _PLANE, "texture": {"kind": "uniform"}, **_PLACE}]
            self.shapeless.add("objects.0")

    def _unused_name(self, path: str) -> str:
        """Return a name that no object has."""
        groups = [self.plain.get(group) for group in ("objects", "plants")]
        items: Iterable[Any] = [item for group in groups if isinstance(group, list) for item in group]
        used = [item.get("name") for item in items if isinstance(item, dict)]
        name = path
        while name in used:
            name += "'"
        return name


def _has_band(texture: Any, band: str) -> bool:
    """Return whether a texture by band has a texture in a band, other than a uniform one by default."""
    textures = texture.get("textures") if isinstance(texture, dict) else None
    return isinstance(textures, dict) and textures.get(band) not in (None, {"kind": "uniform"})


def _replace_value(owner: dict[str, Any], name: str, inside: Keys) -> None:
    """Replace a value, or that of one band, by one without an effect."""
    value = owner.get(name)
    if len(inside) == 1 and isinstance(value, dict) and inside[0] in value and value[inside[0]] != _NEUTRAL[name]:
        value[inside[0]] = _NEUTRAL[name]
    else:
        owner[name] = _NEUTRAL[name]
