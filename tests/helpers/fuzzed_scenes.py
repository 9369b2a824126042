"""A strategy that makes scene files which are almost right: scenes of the library and small ones, mutated."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import yaml
from hypothesis import strategies as some

from scenetruth.camera.sensor import PRESETS, Effect
from scenetruth.discovery import kinds_in
from scenetruth.scene.deformation import OwnFrameModel
from scenetruth.scene.lighting import LightModel
from scenetruth.scene.mesh import MeshModel
from scenetruth.scene.motion import MotionModel
from scenetruth.scene.plant import PlantModel
from scenetruth.scene.suggestions import collect_keys
from scenetruth.scene.texture import TextureModel
from tests.helpers.scenes import LIBRARY, cube, plaid

__all__ = ["scene_files", "scene_trees"]

Place = tuple[Any, Any]
"""A mapping or list, and a key or index in it."""

NUMBERS: list[Any] = [
    *(0, -0.0, 1, -1, 2, 3, 0.5, 90, 180, 360, 1000, 1001, 32768, 32769, 100_000, 10**6, 10**9),
    *(1e-3, 1e-6, 1e-9, 1e-12, 1e-13, 1e-100, 1e-300, 5e-324, 1e3, 1e6, 1e9, 1e12, 1e13, 1e38, 1e39, 1e100, 1e300),
    *(-1e300, 1.7e308, 2**31 - 1, 2**31, 2**53 + 1, 2**63 - 1, 2**63, -(2**63), 2**64, 10**30, 10**400),
    *(float("nan"), float("inf"), float("-inf"), True, "1", "1e3", "0x10", "nan", "١٢", "²"),
]
TEXTS = [
    *("", " ", "a", "auto", "ideal", "null", "\x1b[31mred\x1b[0m", "[red]x[/red]", "a\nb", "a\tb", "\0", "../..", "/"),
    *("ü", "\u202e", "\u2028", "😀", "x" * 300, "{{7*7}}", "<script>", "%s%n", "/dev/zero", "/dev/stdin", "."),
]
TOKENS = [
    *("&a ", "*a", "<<: ", "<<: *a\n", "!!int ", "!!float ", "!!timestamp ", "!!set ", "!!binary ", "!!omap "),
    *("!!python/object:os.system ", "!foo ", "? ", "- ", ": ", "[", "]", "{", "}", "[" * 60, "]" * 60, "'", '"', "|\n"),
    *(">-\n", "\n---\n", "\n...\n", "\t", "\ufeff", "\0", "\x1b", "\x85", "\u2028", "%TAG ! x\n", "%YAML 9.9\n", "#"),
    *("2020-13-45", "12:30:45", "1_000", "~", ".nan", "-.inf", "=", "0o17", "9" * 400, "!!str ", "@", "`", "\\", "\r"),
]


def all_kinds() -> list[str]:
    """Every kind of anything."""
    rooms: list[tuple[Any, tuple[str, ...]]] = [
        (MotionModel, ("motion",)),
        (OwnFrameModel, ("deformation", "vertex_animation")),
        (MeshModel, ("mesh", "leaf")),
        (TextureModel, ("texture", "leaf")),
        (LightModel, ("lighting",)),
        (PlantModel, ("plant",)),
    ]
    found = {kind for base, names in rooms for kind in kinds_in(base, *(f"scenetruth.scene.{name}" for name in names))}
    return sorted(found | set(kinds_in(Effect, "scenetruth.camera.sensor")) | {"chain", "emva1288", "gaussian"})


@cache
def base_trees() -> list[dict[str, Any]]:
    """Scenes of the library with small images and coarse meshes, and small ones with all defaults written out."""
    trees = [yaml.safe_load(file.read_text(encoding="utf-8")) for file in LIBRARY]
    for tree in trees:
        camera = tree["camera"]
        parts = max(camera["width"] // 40, 1)
        camera["width"], camera["height"] = camera["width"] // parts, camera["height"] // parts
        if "focal_length_px" in camera:
            camera["focal_length_px"] /= parts
        else:
            camera["pixel_pitch_um"] *= parts
        camera.pop("principal_point_px", None)
        tree["frames"]["count"] = min(tree["frames"]["count"], 3)
        for plant in tree.get("plants", ()):
            plant["leaves"] = 2
        _coarsen(tree)
    lit = cube(frames={"count": 2}, camera={"width": 40, "height": 30, "focal_length_px": 313}).to_dict()
    lit["lighting"] = {
        "ambient": 0.2,
        "lights": [
            {"kind": "point", "position_mm": [0, 0, 0], "irradiance": 1, "reference_distance_mm": 600},
            {"kind": "directional", "direction": [0, 0, 1], "irradiance": 0.5},
        ],
        "flicker": {"amplitude": 0.1, "period_frames": 7},
    }
    lit["sensor"] = {"kind": "emva1288", "preset": next(iter(PRESETS))}
    flat = plaid(8.0, (0.1, 0.0, 0.0), camera={"width": 24, "height": 20, "focal_length_px": 10}).to_dict()
    flat["optics"] = {"psf": {"kind": "gaussian", "sigma_px": 0.7}, "vignetting": {"coefficients": [-0.1, 0, 0]}}
    flat["shutter"] = {"exposure_time_s": 0.1}
    return [*trees, lit, flat, _everything(), _everything(), *(_grown(kind) for kind in ("rosette", "seedling"))]


def _grown(kind: str) -> dict[str, Any]:
    leaf = {"kind": "leaf", "length_mm": 30, "resolution_mm": 2}
    texture = {"kind": "leaf", "texels_per_mm": 1.5, "mottling_wavelength_mm": [3.0, 9.0]}
    plant: dict[str, Any] = {
        "name": kind,
        "kind": kind,
        "leaf": leaf,
        "texture": texture,
        "position_mm": [0, 0, 200],
        "leaves": 2,
    }
    return {
        "camera": {"width": 40, "height": 30, "focal_length_px": 100},
        "stage": {"positions": 3, "baseline_mm": 2},
        "frames": {"count": 2, "frame_interval_s": 60},
        "plants": [{**plant, "growth": {"kind": "growth", "preset": "leaf_growth_1_percent"}}],
        "render": {"backend": "raycast", "supersampling": 1},
    }


def _everything() -> dict[str, Any]:
    """A scene with most kinds of things."""
    curve = {"kind": "harmonic", "amplitude": 2.0, "period_frames": 9.0, "phase_deg": 20.0, "mean": 1.0}
    keyed = {"kind": "keyframes", "times_frames": [-2.0, 0.0, 3.0], "values": [1.0, 0.0, 2.0]}
    sheet: dict[str, Any] = {"size_mm": [30.0, 20.0], "resolution_mm": 4.0}
    shapes: dict[str, dict[str, Any]] = {
        "box": {"size_mm": [12.0, 11.0, 10.0]},
        "plane": sheet,
        "sphere": {"radius_mm": 9.0, "resolution_mm": 4.0, "cap_deg": 70.0},
        "cylinder": {"radius_mm": 7.0, "length_mm": 14.0, "caps": True, "resolution_mm": 4.0},
        "torus": {"ring_radius_mm": 9.0, "tube_radius_mm": 3.0, "resolution_mm": 3.0},
        "saddle": {**sheet, "curvature_per_mm": 0.01},
        "relief": {**sheet, "amplitude_mm": 1.0, "wavelength_mm": [20.0, None], "phase_deg": [10.0, 0.0]},
        "stairs": {"tread_mm": [8.0, 20.0], "steps_mm": [2.0, -3.0], "risers": True},
        "leaf": {"length_mm": 30.0, "resolution_mm": 2.0, "bend_along_deg": 20.0, "fold_deg": 10.0},
    }
    textures: list[dict[str, Any]] = [
        {"kind": "uniform", "radiance": 0.4},
        {"kind": "checkerboard", "square_mm": 5.0, "radiances": [0.2, 0.8]},
        {"kind": "plaid", "wavelength_mm": [9.0, 7.0], "amplitude": 0.3, "phase_deg": [5.0, 6.0]},
        {"kind": "noise", "wavelength_mm": [5.0, 15.0], "rms_contrast": 0.2, "spectrum_exponent": -1.0},
    ]
    motions: list[dict[str, Any]] = [
        {"kind": "velocity", "velocity_mm_per_frame": [0.1, 0.2, -0.3]},
        {"kind": "acceleration", "acceleration_mm_per_frame2": [0.01, 0.0, 0.02]},
        {"kind": "exponential", "direction": [0, 0, 1], "amplitude_mm": 2.0, "time_constant_frames": 20.0},
        {
            "kind": "nutation",
            "direction": [0, 0, 1],
            "towards": [1, 0, 0],
            "amplitudes_deg": [3, 2],
            "period_frames": 9,
        },
        {"kind": "rotation", "axis": [0, 1, 0.5], "rate_deg_per_frame": 1.5, "point_mm": [0, 0, 190]},
        {"kind": "shift", "direction": [1, 1, 0], "distance_mm": curve},
        {"kind": "turn", "axis": [0, 0, 1], "angle_deg": keyed},
        {"kind": "keyframes", "times_frames": [-1.0, 0.0, 2.0], "positions_mm": [[0, 0, 0], [1, 0, 0], [2, 1, 0]]},
        {"kind": "velocity", "velocity_mm_per_frame": [0.0, 0.0, 0.0]},
    ]
    deformations: dict[str, dict[str, Any]] = {
        "plane": {"kind": "bending", "angle_deg": curve, "from_mm": -5.0, "length_mm": 12.0},
        "saddle": {"kind": "growth", "rate_per_hour": 0.02, "base_to_tip": [1.5, 0.5], "diel_amplitude": 0.3},
        "relief": {"kind": "star", "amplitude_mm": 0.2, "period_mm": [20.0, 9.0]},
        "leaf": {"kind": "hinge", "axis": [0, 1, 0], "angle_deg": keyed},
        "sphere": {"kind": "unrolling", "length_mm": 30.0, "front_mm": 5.0, "radius_mm": 20.0},
    }
    objects: list[dict[str, Any]] = [
        {
            "name": kind,
            "mesh": fields | {"kind": kind},
            "texture": textures[number % len(textures)],
            "pose": {
                "position_mm": [20.0 * (number % 3 - 1), 20.0 * (number // 3 - 1), 200.0],
                "rotations": [{"axis": [1, 0.2, 0], "angle_deg": 8.0}],
            },
            "deformation": [deformations[kind]] if kind in deformations else [],
            "motion": [motions[number]],
        }
        for number, (kind, fields) in enumerate(shapes.items())
    ]
    stage: dict[str, Any] = {
        **{"positions_mm": [-3.0, 0.0, 2.0], "rows": 2, "row_spacing_mm": 4.0, "scan": "bidirectional"},
        **{"time_per_position_s": 0.5, "errors": {"preset": "screw_stage", "yaw_urad": 20.0}},
    }
    effects: list[dict[str, Any]] = [
        {"kind": "photon_conversion", "photon_rate_per_s": 1e6, "exposure_time_s": 0.01},
        {"kind": "quantum_efficiency", "quantum_efficiency": 0.6},
        {"kind": "dark_current", "exposure_time_s": 0.01, "dark_current_e_per_s": 10.0},
        *({"kind": "shot_noise"}, {"kind": "full_well", "full_well_e": 9000.0}),
        {"kind": "readout_noise", "temporal_dark_noise_e": 5.0},
        {"kind": "gain", "gain_dn_per_e": 0.03, "black_level_dn": 4.0},
        {"kind": "digitisation", "bit_depth": 8},
    ]
    return {
        "description": "everything",
        "camera": {"width": 40, "height": 36, "focal_length_px": 100.0, "distortion": {"k1": -0.1, "p1": 0.001}},
        "optics": {
            "psf": {"kind": "airy", "wavelength_um": 0.5, "f_number": 8.0, "pixel_pitch_um": 5.0},
            "defocus": {"aperture_mm": 2.0, "focus_distance_mm": 210.0, "samples": 8},
        },
        "shutter": {"exposure_time_s": 0.1, "readout_time_s": 0.2, "stage_speed_mm_per_s": 1.0},
        "stage": stage,
        "frames": {"count": 3, "frame_interval_s": 10.0},
        "objects": objects,
        "background": 0.1,
        "lighting": {
            "ambient": 0.2,
            "lights": [
                {
                    **{"kind": "spot", "position_mm": [0, 0, 0], "target_mm": [0, 0, 200], "inner_angle_deg": 10.0},
                    **{"outer_angle_deg": 30.0, "irradiance": 0.5, "reference_distance_mm": 200.0},
                    "motion": [{"kind": "rotation", "axis": [0, 1, 0], "rate_deg_per_frame": 1.0}],
                },
                {"kind": "directional", "direction": [0.1, 0, 1], "irradiance": 0.3},
            ],
            "drift_per_frame": 0.01,
            "flicker": {"amplitude": 0.1, "period_frames": 7.0},
        },
        "sensor": {"kind": "chain", "effects": effects},
        "estimate": {"method": "structure_tensor", "window_sigma_px": 4.0, "tau": "auto"},
        "score": {"interior_margin_px": 3.0, "slope_classes_deg": [0.0, 30.0, 90.0], "contrast_window_px": 3.0},
        "render": {"backend": "raycast", "supersampling": 2},
        "seed": 3,
    }


def _coarsen(tree: Any) -> None:
    """Make textures and meshes of a tree quick to make."""
    for container, key in places(tree):
        value = container[key]
        if not isinstance(value, dict):
            continue
        if value.get("kind") == "leaf" and "length_mm" not in value:
            value |= {"texels_per_mm": 0.8, "mottling_wavelength_mm": [6.0, 15.0], "speckle_size_mm": 1.0}
        elif "resolution_mm" in value or value.get("kind") in ("sphere", "cylinder", "torus", "relief", "saddle"):
            value["resolution_mm"] = (1.5 if value.get("kind") == "leaf" else 6) * value.get("resolution_mm", 0.5)
        elif value.get("kind") == "noise":
            value["wavelength_mm"] = [20 * value["wavelength_mm"][0], 40 * value["wavelength_mm"][0]]


def places(tree: Any) -> Iterator[Place]:
    """Every value below the top of a tree, by where it is."""
    inside = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(inside):
        yield tree, key
        if isinstance(value, dict | list):
            yield from places(value)


def _put(place: Place, value: Any) -> None:
    container, key = place
    container[key] = value


def _delete(draw: Any, place: Place, tree: Any) -> None:
    del place[0][place[1]]


def _duplicate(draw: Any, place: Place, tree: Any) -> None:
    container, key = place
    if isinstance(container, list):
        container += [copy.deepcopy(container[key])] * draw(some.sampled_from([1, 2, 40]))
    else:
        container[f"{key}_again"] = container[key]


def _number(draw: Any, place: Place, tree: Any) -> None:
    _put(place, draw(some.sampled_from(NUMBERS)))


def _scale(draw: Any, place: Place, tree: Any) -> None:
    container, key = place
    numbers = [item for item in [place, *places([container[key]])] if _is_number(item[0][item[1]])]
    factor = draw(some.sampled_from([-1, 0, 0.1, 0.5, 0.8, 1.1, 1.5, 2, 3, 10, 1e3, 1e6, 1e10, 1e-3, 1e-6, 1e-10]))
    for where in numbers:
        _put(where, where[0][where[1]] * factor)


def _is_number(value: Any) -> bool:
    """Whether a value is a number that can be multiplied with a float."""
    return isinstance(value, int | float) and not isinstance(value, bool) and (value != value or abs(value) < 10**300)


def _gentle(draw: Any, place: Place, tree: Any) -> None:
    """Change a number a little, so that most scenes stay possible."""
    numbers = [item for item in places(tree) if _is_number(item[0][item[1]])]
    where = numbers[draw(some.integers(0, len(numbers) - 1))] if numbers else place
    value = where[0][where[1]]
    if isinstance(value, int):
        _put(where, value + draw(some.integers(-3, 3)))
    elif isinstance(value, float):
        _put(where, value * draw(some.floats(0.3, 3)) * draw(some.sampled_from([1, 1, 1, -1])))


def _text(draw: Any, place: Place, tree: Any) -> None:
    _put(place, draw(some.sampled_from(TEXTS)))


def _kind(draw: Any, place: Place, tree: Any) -> None:
    kinds = [item for item in places(tree) if item[1] == "kind"] or [place]
    _put(kinds[draw(some.integers(0, len(kinds) - 1))], draw(some.sampled_from(all_kinds())))


def _elsewhere(draw: Any, place: Place, tree: Any) -> None:
    other = draw(some.sampled_from(base_trees()))
    found = list(places(other))
    container, key = found[draw(some.integers(0, len(found) - 1))]
    _put(place, copy.deepcopy(container[key]))


def _same_key(draw: Any, place: Place, tree: Any) -> None:
    """Take what has the same key in another scene: it is likely to fit."""
    found = [item for other in base_trees() for item in places(other) if item[1] == place[1]]
    container, key = found[draw(some.integers(0, len(found) - 1))] if found else place
    _put(place, copy.deepcopy(container[key]))


def _rename(draw: Any, place: Place, tree: Any) -> None:
    container, key = place
    if isinstance(container, dict):
        value = container.pop(key)
        container[draw(some.sampled_from(sorted(collect_keys())) | some.sampled_from(TEXTS) | some.just(3))] = value


def _add(draw: Any, place: Place, tree: Any) -> None:
    container, _ = place
    if isinstance(container, dict):
        container[draw(some.sampled_from(sorted(collect_keys())))] = draw(some.sampled_from(NUMBERS) | junk)


def _retype(draw: Any, place: Place, tree: Any) -> None:
    container, key = place
    value = container[key]
    _put(place, draw(some.sampled_from([[value], {"kind": value}, {}, [], None, str(value), [value, value], True])))


def _junk(draw: Any, place: Place, tree: Any) -> None:
    _put(place, draw(junk))


junk = some.recursive(
    some.none() | some.booleans() | some.sampled_from(NUMBERS) | some.sampled_from(TEXTS),
    lambda inner: (
        some.lists(inner, max_size=3)
        | some.dictionaries(some.sampled_from(["kind", "file", "camera", "x", "values", "t"]), inner, max_size=3)
    ),
    max_leaves=6,
)
CHANGES: list[Callable[[Any, Place, Any], None]] = [
    *(_delete, _duplicate, _number, _number, _text, _kind, _kind, _elsewhere, _rename, _add, _retype, _junk),
    *(_scale, _scale, _scale, _scale, _gentle, _gentle, _gentle, _gentle, _gentle, _same_key, _same_key, _same_key),
]


@some.composite
def scene_trees(draw: Any) -> Any:
    """Plain trees of scenes, changed in one to four places."""
    tree = copy.deepcopy(draw(some.sampled_from(base_trees())))
    for _ in range(draw(some.sampled_from([1, 1, 1, 2, 4]))):
        found = list(places(tree))
        if not found:
            break
        place = found[draw(some.integers(0, len(found) - 1))]
        draw(some.sampled_from(CHANGES))(draw, place, tree)
    return tree


@some.composite
def scene_files(draw: Any) -> bytes:
    """Contents of scene files: two of three are spelled well, the others changed as text."""
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    tree = draw(scene_trees())
    flow = draw(some.sampled_from([False, None]))
    text = str(yaml.dump(tree, Dumper=dumper, sort_keys=False, default_flow_style=flow))
    if draw(some.integers(0, 2)) < 2:
        return text.encode("utf-8", "surrogatepass")
    for _ in range(draw(some.integers(1, 3))):
        text = _changed_text(draw, text)
    content = bytearray(text.encode("utf-8", "surrogatepass"))
    if content and draw(some.integers(0, 3)) == 0:
        content[draw(some.integers(0, len(content) - 1))] ^= 1 << draw(some.integers(0, 7))
    return bytes(content)


def _changed_text(draw: Any, text: str) -> str:
    at = draw(some.integers(0, max(len(text) - 1, 0)))
    lines = text.splitlines(keepends=True) or [""]
    number = draw(some.integers(0, len(lines) - 1))
    match draw(some.sampled_from(["insert", "insert", "value", "cut", "line", "twice", "indent"])):
        case "insert":
            return text[:at] + str(draw(some.sampled_from(TOKENS))) + text[at:]
        case "value":
            head, colon, rest = lines[number].partition(":")
            lines[number] = head + colon + " " + draw(some.sampled_from(TOKENS)) + rest.lstrip(" ")
        case "cut":
            return text[:at]
        case "line":
            del lines[number]
        case "twice":
            lines.insert(number, lines[number])
        case "indent":
            lines[number] = " " * draw(some.integers(1, 4)) + lines[number]
    return "".join(lines)
