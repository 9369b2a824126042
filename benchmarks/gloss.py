"""Check gloss against the conservation of energy and Mitsuba 3, and print tables in Markdown.

Run from the top of the repository: ``python -m benchmarks.gloss``; with Mitsuba in the environment
(``pip install mitsuba``), single reflections are compared as well.
"""

from __future__ import annotations

import importlib.util
import time
from typing import Any

import numpy as np
from benchmarks.jobs import heading, line
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.camera import Viewpoint
from scenetruth.render import choose_renderer
from scenetruth.render.reflectance_kernels import reflect_light
from scenetruth.render.reflection import pack_materials
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
GLOSSY = ("plants.0.material.preset=wheat_leaf", "plants.0.material.transmittance=0.4")


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
        "sensor": {
            "type": "perspective",
            "fov": float(np.rad2deg(2 * np.arctan(WIDTH / 2 / FOCAL))),
            "to_world": turn().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": SAMPLES},
        },
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
    matt, glossy, ring = render_ms(()), render_ms(GLOSSY), render_ms((*GLOSSY, RING))
    print(f"\n{SCENE}, image of one camera: matt {matt:.0f} ms, gloss and transmission {glossy:.0f} ms")
    print(f"with a ring lamp in place of parallel light {ring:.0f} ms")


if __name__ == "__main__":
    main()
