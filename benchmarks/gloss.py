"""Check gloss against the conservation of energy and Mitsuba 3, and print tables in Markdown.

Run from the top of the repository: ``python -m benchmarks.gloss``; with Mitsuba in the environment
(``pip install mitsuba``), single reflections, penumbrae and images of bodies are compared as well.
"""

from __future__ import annotations

import importlib.util
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import scenetruth as st
from benchmarks.jobs import heading, line
from scenetruth.camera import Viewpoint
from scenetruth.render import choose_renderer
from scenetruth.render.reflectance_kernels import reflect_light
from scenetruth.render.reflection import ReflectionTables, pack_materials
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.material import Material

Floats = NDArray[np.float64]

WHITE = {
    "boundary, n = 1.5, α = 0.3": Material(refractive_index=1.5, roughness=0.3),
    "boundary, n = 1.5, α = 1": Material(refractive_index=1.5, roughness=1.0),
    "wheat leaf": Material.model_validate({"preset": "wheat_leaf"}),
    "metal, α = 0.3": Material(metallic=1.0, roughness=0.3),
    "metal, α = 0.9": Material(metallic=1.0, roughness=0.9),
}
"""Materials of which a white surface reflects all light."""
SINGLE = ((1.5, 0.3, 0.3), (1.32, 0.27, 0.56), (1.5, 0.1, 0.1))
"""Refractive index and roughness along and across of single reflections."""
PAIRS = 200
SCENE = "rosette"
RING = (
    "lighting.lights=[{kind: ring, position_mm: [0, 0, 0], direction: [0, 0, 1], inner_radius_mm: 30, radius_mm: 60, "
    "irradiance: 0.75, reference_distance_mm: 600}]"
)
GLOSSY = ("plants.0.material.preset=wheat_leaf", "plants.0.material.transmittance=0.2")


def reflect(material: Material, to_camera: Floats, to_light: Floats, *, once: bool = False) -> tuple[Floats, Floats]:
    """Return factor and gloss for pairs of directions, in the frame of the surface, shape (n, 3) each.

    ``once``: Without the light that is reflected by several facets.
    """
    count = len(to_light)
    tables = pack_materials([material])
    if once:
        tables.values[0, 7] = 0.0
    factors, gloss = np.zeros((2, count))
    up = np.tile([0.0, 0.0, 1.0], (count, 1))
    view = (np.zeros(3), -to_camera, up, np.zeros(count, dtype=np.int32))
    surface = (np.array([[1.0, 0.0, 0.0]]), np.zeros(1, dtype=np.int32), *tables)
    reflect_light(np.ones(count), np.ascontiguousarray(to_light), view, surface, factors, gloss)
    return factors, gloss


def hemisphere(count: int) -> tuple[Floats, Floats]:
    """Return directions and weights of the midpoint rule; radiances include the cosine."""
    polar = (np.arange(count) + 0.5) / count * np.pi / 2
    around = (np.arange(4 * count) + 0.5) / (4 * count) * 2 * np.pi
    theta, phi = (item.ravel() for item in np.meshgrid(polar, around, indexing="ij"))
    light = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
    return light, np.pi * np.sin(theta) / (4 * count**2)


def drawn(generator: np.random.Generator, count: int) -> Floats:
    """Return directions at least 3 degrees above the surface."""
    level, around = generator.uniform(0.05, 1.0, count), generator.uniform(0, 2 * np.pi, count)
    flat = np.sqrt(1 - level**2)
    return np.stack([flat * np.cos(around), flat * np.sin(around), level], axis=1)


def by_mitsuba(index: float, along: float, across: float, to_camera: Floats, to_light: Floats) -> Floats:
    """Return π times the reflectance of Mitsuba for pairs of directions, cosine included."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    kind = {"type": "roughconductor", "distribution": "ggx", "eta": index, "k": 0.0}
    bsdf = mi.load_dict({**kind, "alpha_u": along, "alpha_v": across})
    values = []
    for camera, light in zip(to_camera, to_light, strict=True):
        place = mi.SurfaceInteraction3f()
        place.wi, place.uv = camera.tolist(), [0, 0]
        values.append(bsdf.eval(mi.BSDFContext(), place, light.tolist())[0])
    return np.pi * np.array(values)


LAMPS: dict[str, dict[str, Any]] = {
    "disc": {"kind": "disc", "radius_mm": 40},
    "ring": {"kind": "ring", "inner_radius_mm": 30, "radius_mm": 60},
}
"""Lamps behind the camera, whose light on a plane with a sheet in front of it is compared with Mitsuba."""
FACING = {"position_mm": [0, 0, -20], "direction": [0, 0, 1], "irradiance": 0.8, "reference_distance_mm": 500}
WIDTH, HEIGHT, FOCAL, SHEET, SAMPLES = 24, 8, 500.0, 440.0, 1 << 14


def seen_from_origin(width: int, height: int, focal: float) -> dict[str, Any]:
    """Return a camera of Mitsuba at the origin that looks along Z; pixels have the mean over their square."""
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": float(np.rad2deg(2 * np.arctan(width / 2 / focal))),
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}},
    }


def penumbra(lamp: dict[str, Any]) -> tuple[Floats, Floats]:
    """Return images of a penumbra on a plane, and of Mitsuba, shape (HEIGHT, n)."""
    import mitsuba as mi

    black, white = {"kind": "uniform", "radiance": 0.0}, {"kind": "uniform", "radiance": 1.0}
    scene = st.load_scene(
        {
            "camera": {"width": WIDTH, "height": HEIGHT, "focal_length_px": FOCAL},
            "stage": {"positions": 2, "baseline_mm": 1.0},
            "frames": {"count": 1},
            "render": {"backend": "raycast"},
            "objects": [
                {"name": "ground", "mesh": {"kind": "plane", "size_mm": [300, 300]}, "texture": white}
                | {"pose": {"position_mm": [0, 0, 500]}},
                {"name": "sheet", "mesh": {"kind": "plane", "size_mm": [400, 600]}, "texture": black}
                | {"pose": {"position_mm": [-205, 0, SHEET]}},
            ],
            "lighting": {"lights": [{**FACING, **lamp}]},
        }
    )
    with choose_renderer(scene, build_scene(scene)).renderer as renderer:
        found = renderer.render(0.0, Viewpoint.on_axis(0.0)).astype(np.float64)
    light = scene.lighting.lamps_at(0.0)[0]
    assert light.area is not None
    inner, outer = light.area.sizes_mm
    mi.set_variant("scalar_rgb")
    turn = mi.ScalarTransform4f
    matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    dark = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": light.area.radiance}}
    plain: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": seen_from_origin(WIDTH, HEIGHT, FOCAL)
        | {"sampler": {"type": "independent", "sample_count": SAMPLES}},
        "lamp": {"type": "disk", "to_world": turn().translate([0, 0, -20]).scale(outer), "emitter": emitter},
        "ground": {"type": "disk", "bsdf": matt}
        | {"to_world": turn().translate([0, 0, 500]).rotate([1, 0, 0], 180).scale(300)},
        "sheet": {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": dark}}
        | {"to_world": turn().translate([-205, 0, SHEET]).scale([200, 300, 1])},
    }
    if inner > 0:
        place = turn().translate([0, 0, -19.5]).scale(inner)
        plain["opening"] = {"type": "disk", "bsdf": {"type": "twosided", "bsdf": dark}, "to_world": place}
    expected = np.pi * np.array(mi.render(mi.load_dict(plain)))[..., 0]
    # Without the pixels that the outline of the sheet crosses, and those of the sheet.
    clear = found.min(axis=0) > 0
    clear[np.flatnonzero(clear)[0]] = False
    return found[:, clear], expected[:, clear].astype(np.float64)


COLUMNS, ROWS, ZOOM, BLOCK, SPREAD = 48, 36, 400.0, 4, 1 << 10
"""Images of bodies: size, focal length in px, side of the blocks that are compared, samples of Mitsuba per pixel."""
FRONT, BACK = 0.75, 0.25
"""Textures of bodies, and of the plane behind them."""
BODIES: dict[str, dict[str, Any]] = {
    "inclined plane": {
        "mesh": {"kind": "plane", "size_mm": [100, 90]},
        "pose": {"position_mm": [0, 0, 500], "rotations": [{"axis": [1, 0.5, 0], "angle_deg": 35}]},
    },
    "sphere": {
        "mesh": {"kind": "sphere", "radius_mm": 15, "resolution_mm": 0.3},
        "pose": {"position_mm": [2, -1, 490]},
    },
    "sphere of 3 px facets": {
        "mesh": {"kind": "sphere", "radius_mm": 15, "resolution_mm": 4},
        "pose": {"position_mm": [2, -1, 490]},
    },
    "leaf": {
        "mesh": {
            "kind": "leaf",
            "length_mm": 40,
            "width_mm": 26,
            "bend_along_deg": -40,
            "bend_across_deg": -30,
            "fold_deg": 20,
            "undulation": {"amplitude_mm": 2, "waves_per_side": 2},
            "resolution_mm": 0.3,
        },
        "pose": {"position_mm": [-18, -8, 500], "rotations": [{"axis": [0, 0, 1], "angle_deg": 25}]},
    },
}
"""Bodies; pixels are 1.25 mm wide."""
SAMPLINGS = ("auto", 12)
"""Values of `render.supersampling`."""
SURFACES: dict[str, dict[str, Any]] = {
    "matt": {},
    "black, n = 1.5, α = 0.3": {"refractive_index": 1.5, "roughness": 0.3},
}
_PLACE, _TARGET = [160, -120, 100], [0, 0, 500]
_STRENGTH = {"irradiance": 0.8, "reference_distance_mm": 430}
SHINING: dict[str, dict[str, Any]] = {
    "directional": {"kind": "directional", "direction": [-0.4, 0.3, 1.0], "irradiance": 0.8},
    "disc": {"kind": "disc", "position_mm": _PLACE, "target_mm": _TARGET, "radius_mm": 40, **_STRENGTH},
    "sphere": {"kind": "sphere", "position_mm": _PLACE, "radius_mm": 30, **_STRENGTH},
}
"""Lamps of the images."""


def pack_once(materials: Sequence[Material]) -> ReflectionTables:
    """Return the tables of materials, without the light that is reflected by several facets."""
    tables = pack_materials(materials)
    tables.values[:, 7:9] = 0.0
    return tables


def body_images(body: str, surface: str, lamp: str) -> tuple[list[Floats], Floats, Floats]:
    """Return the images of a body with all samplings, and two of Mitsuba, shape (ROWS, COLUMNS)."""
    import mitsuba as mi

    radiance = 0.0 if SURFACES[surface] else FRONT
    lighting = {"lights": [SHINING[lamp]]}
    scenes = [body_scene(body, radiance, SURFACES[surface], lighting, sampling) for sampling in SAMPLINGS]
    found = [rendered(scene, once=True) for scene in scenes]
    mi.set_variant("scalar_rgb")
    matt: list[dict[str, Any]] = [
        {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}} for value in (FRONT, BACK)
    ]
    if SURFACES[surface]:
        matt[0] = {"type": "roughconductor", "distribution": "ggx", "eta": 1.5, "k": 0.0, "alpha": 0.3}
    plain: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0},
        "sensor": seen_from_origin(COLUMNS, ROWS, ZOOM) | {"sampler": {"type": "multijitter", "sample_count": SPREAD}},
        "lamp": lamp_of_mitsuba(scenes[0]),
    }
    with tempfile.TemporaryDirectory() as folder:
        for number, item in enumerate(build_scene(scenes[0]).bodies):
            file = str(Path(folder) / f"{number}.ply")
            mesh = mi.Mesh(item.name, len(item.vertices_mm), len(item.faces))
            values = mi.traverse(mesh)
            values["vertex_positions"] = item.vertices_mm.ravel().astype(np.float32)
            values["faces"] = item.faces.ravel().astype(np.uint32)
            values.update()
            mesh.write_ply(file)
            plain[item.name] = {"type": "ply", "filename": file, "face_normals": True}
            plain[item.name]["bsdf"] = {"type": "twosided", "bsdf": matt[number]}
        loaded = mi.load_dict(plain)
    one, other = (np.pi * np.array(mi.render(loaded, seed=seed))[..., 0].astype(np.float64) for seed in (1, 2))
    return found, one, other


def body_scene(
    body: str,
    radiance: float,
    material: dict[str, Any],
    lighting: dict[str, Any],
    sampling: str | int = "auto",
) -> st.Scene:
    """Return the scene of a body in front of a matt plane."""
    item = {"name": "body", "texture": {"kind": "uniform", "radiance": radiance}, "material": material, **BODIES[body]}
    behind = {"name": "behind", "texture": {"kind": "uniform", "radiance": BACK}, "pose": {"position_mm": [0, 0, 525]}}
    return st.load_scene(
        {
            "camera": {"width": COLUMNS, "height": ROWS, "focal_length_px": ZOOM},
            "stage": {"positions": 2, "baseline_mm": 1.0},
            "frames": {"count": 1},
            "render": {"backend": "raycast", "supersampling": sampling},
            "objects": [item, behind | {"mesh": {"kind": "plane", "size_mm": [100, 90]}}],
            "lighting": lighting,
        }
    )


def rendered(scene: st.Scene, *, once: bool = False) -> Floats:
    """Return the image of a scene, shape (ROWS, COLUMNS); ``once``: see `reflect`."""
    pack = pack_once if once else pack_materials
    with (
        patch("scenetruth.render.reflection.pack_materials", pack),
        choose_renderer(scene, build_scene(scene)).renderer as renderer,
    ):
        return renderer.render(0.0, Viewpoint.on_axis(0.0)).astype(np.float64)


def lamp_of_mitsuba(scene: st.Scene) -> dict[str, Any]:
    """Return the lamp of a scene for Mitsuba."""
    import mitsuba as mi

    light = scene.lighting.lamps_at(0.0)[0]
    if light.area is None:
        irradiance = {"type": "rgb", "value": light.irradiance}
        return {"type": "directional", "direction": light.axis.tolist(), "irradiance": irradiance}
    assert light.position_mm is not None
    place, radius = light.position_mm.tolist(), light.area.sizes_mm[1]
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": light.area.radiance}}
    if light.area.shape == "sphere":
        return {"type": "sphere", "center": place, "radius": radius, "emitter": emitter}
    towards = (light.position_mm + light.axis).tolist()
    facing = mi.ScalarTransform4f().look_at(origin=place, target=towards, up=light.area.across.tolist())
    return {"type": "disk", "to_world": facing.scale(radius), "emitter": emitter}


def block_means(image: Floats, kept: NDArray[np.bool_]) -> Floats:
    """Return the means of an image over the kept pixels of blocks that have some."""
    shape = (ROWS // BLOCK, BLOCK, COLUMNS // BLOCK, BLOCK)
    total, count = ((part * kept).reshape(shape).sum(axis=(1, 3)) for part in (image, np.ones_like(image)))
    return np.asarray(total[count > 0] / count[count > 0])


def body_rows(body: str, surface: str) -> list[tuple[str, ...]]:
    """Return the differences of a body, and of the plane behind it, from Mitsuba."""
    unlit = rendered(body_scene(body, FRONT, {}, {}))
    images = [body_images(body, surface, lamp) for lamp in SHINING]
    rows = []
    for name, texture in ((body, FRONT), (f"plane behind the {body}", BACK)):
        kept = np.abs(unlit - texture) < 1e-6  # no pixels of outlines
        if not kept.any():
            continue
        for number, sampling in enumerate(SAMPLINGS):
            cells, noise = [], []
            for found, *others in images:
                own, one, other = (block_means(item, kept) for item in (found[number], *others))
                expected = (one + other) / 2
                cells.append(f"{np.sqrt(np.mean((own - expected) ** 2)) / expected.mean():.1e}")
                noise.append(np.sqrt(np.mean((one - other) ** 2)) / 2 / expected.mean())
            kind = surface if texture == FRONT else "matt"
            rows.append((name, kind, str(sampling), *cells, f"{max(noise):.1e}"))
    return rows


def render_ms(overrides: tuple[str, ...]) -> float:
    """Return the processor time of an image in ms, the least of three."""
    scene = st.load_scene(SCENE, overrides=overrides)
    world, times = build_scene(scene), []
    with choose_renderer(scene, world).renderer as renderer:
        for _ in range(4):
            started = time.process_time()
            renderer.render(0.0, Viewpoint.on_axis(0.0))
            times.append(1e3 * (time.process_time() - started))
    return min(times[1:])


def main() -> None:
    """Print all tables."""
    light, weights = hemisphere(600)
    cosines = (1.0, 0.6, 0.2, 0.05)
    print(heading(("white surface", *(f"cos θ = {cosine:g}" for cosine in cosines))))
    for name, material in WHITE.items():
        totals = []
        for cosine in cosines:
            flat = np.sqrt(1 - cosine**2)
            camera = np.tile([flat * np.cos(0.3), flat * np.sin(0.3), cosine], (len(light), 1))
            factors, gloss = reflect(material, camera, light)
            totals.append(f"{weights @ (factors + gloss):.5f}")
        print(line((name, *totals)))
    if importlib.util.find_spec("mitsuba") is None:
        print("\nmitsuba is not installed")
    else:
        print()
        print(heading(("n", "α along", "α across", "largest relative difference from Mitsuba", "pairs")))
        generator = np.random.default_rng(1)
        for index, along, across in SINGLE:
            camera, towards = drawn(generator, PAIRS), drawn(generator, PAIRS)
            material = Material(refractive_index=index, roughness=across, roughness_along=along)
            _, gloss = reflect(material, camera, towards, once=True)
            worst = float(np.abs(gloss / by_mitsuba(index, along, across, camera, towards) - 1).max())
            print(line((f"{index:g}", f"{along:g}", f"{across:g}", f"{worst:.1e}", str(PAIRS))))
        print()
        print(heading(("lamp", "rms difference of a penumbra from Mitsuba, of full scale", "samples per column")))
        for name, lamp in LAMPS.items():
            found, expected = penumbra(lamp)
            rms = float(np.sqrt(np.mean((found - expected).mean(axis=0) ** 2))) / found.max()
            print(line((name, f"{rms:.1e}", str(SAMPLES * HEIGHT))))
        print()
        print(
            heading(
                (
                    "rms relative difference from Mitsuba",
                    "surface",
                    "supersampling",
                    *SHINING,
                    "noise of Mitsuba, at most",
                )
            )
        )
        for surface in SURFACES:
            for body in BODIES:
                for row in body_rows(body, surface):
                    print(line(row))
    matt, glossy, ring = render_ms(()), render_ms(GLOSSY), render_ms((*GLOSSY, RING))
    print(f"\n{SCENE}, image of one camera: matt {matt:.0f} ms, gloss and transmission {glossy:.0f} ms")
    print(f"with a ring lamp in place of parallel light {ring:.0f} ms")


if __name__ == "__main__":
    main()
