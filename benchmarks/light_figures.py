"""Check light against conservation of energy and closed forms, measure its run time, and print tables in Markdown.

Run from the top of the repository: ``python -m benchmarks.light_figures``.
"""

from __future__ import annotations

import math
import time
import warnings
from contextlib import ExitStack
from typing import Any
from unittest import mock

import numba
import numpy as np

import scenetruth as st
from benchmarks.gloss import GLOSSY, RING, SCENE, Floats, hemisphere, reflect
from benchmarks.jobs import heading, line
from scenetruth.camera import Viewpoint
from scenetruth.render import area_lamps, choose_renderer
from scenetruth.render.lamp_lattice_kernels import CLEAR, EXACT, UNKNOWN
from scenetruth.render.reflectance_kernels import albedo_tables
from scenetruth.scene.built_scene import build_scene
from scenetruth.scene.material import Material

BODIES: dict[str, dict[str, Any]] = {
    "sphere": {"kind": "sphere", "radius_mm": 30, "resolution_mm": 4.0},
    "box": {"kind": "box", "size_mm": [40, 40, 40]},
}
"""Closed convex bodies."""
SURFACES: dict[str, dict[str, Any]] = {
    "matt": {},
    **{
        f"n = 1.5, α = {rough:g}": {"refractive_index": 1.5, "roughness": rough} for rough in (0.05, 0.1, 0.3, 0.6, 1.0)
    },
    "wheat leaf, transmittance 0.4": {"preset": "wheat_leaf", "reflectance": 0.6, "transmittance": 0.4},
    "metal, α = 0.3": {"metallic": 1.0, "roughness": 0.3},
    "half metal, n = 1.5, α = 0.3": {"metallic": 0.5, "refractive_index": 1.5, "roughness": 0.3},
}
"""Materials with which a white surface sends out all light that it receives."""
HALF_MM, TARGET_MM = 400.0, 600.0
FIXED = "render.supersampling=3"
CHANGES: dict[str, tuple[str, ...]] = {
    "as bundled": (),
    "gloss and transmission": GLOSSY,
    "gloss, transmission, ring lamp": (*GLOSSY, RING),
    "the same without shadows": (*GLOSSY, RING, "lighting.shadows=false"),
    "as bundled, 3 x 3 samples": (FIXED,),
    "gloss, transmission, ring lamp, 3 x 3 samples": (*GLOSSY, RING, FIXED),
}
"""Variants of the rosette."""
ROUNDS = 4
PLACE = "reference_distance_mm: 600, irradiance: 0.75"
LAMPS = {
    "disc, 12 mm": f"{{kind: disc, position_mm: [-200, -100, 100], target_mm: [0, 0, 600], radius_mm: 12, {PLACE}}}",
    "disc, 60 mm": f"{{kind: disc, position_mm: [250, -150, 0], target_mm: [0, 0, 600], radius_mm: 60, {PLACE}}}",
    "rectangle": f"{{kind: rectangle, position_mm: [99, -200, 0], target_mm: [0, 0, 600], size_mm: [90, 30], {PLACE}}}",
    "sphere": f"{{kind: sphere, position_mm: [-150, -200, 50], radius_mm: 18, {PLACE}}}",
}
PENUMBRAE: dict[str, tuple[str, tuple[str, ...]]] = {
    "rosette, ring": (SCENE, (*GLOSSY, RING)),
    **{f"rosette, {name}": (SCENE, (*GLOSSY, f"lighting.lights=[{lamp}]")) for name, lamp in LAMPS.items()},
    "leaf, disc, 12 mm": ("leaf", (f"lighting.lights=[{LAMPS['disc, 12 mm']}]",)),
    "seedling, sphere": ("seedling", (f"lighting.lights=[{LAMPS['sphere']}]",)),
}
"""Scenes and lamps for errors of interpolated shares."""
FURTHER = 2e-3


def walls() -> list[dict[str, Any]]:
    """Return six lamps that enclose a body, with irradiances that give the radiance of a white matt surface."""
    places = [(axis, sign) for axis in range(3) for sign in (-1, 1)]
    lamps = []
    for axis, sign in places:
        centre, direction = [0.0, 0.0, TARGET_MM], [0.0, 0.0, 0.0]
        centre[axis] += sign * HALF_MM
        direction[axis] = -float(sign)
        across = [0.0, 0.0, 0.0]
        across[(axis + 1) % 3] = 1.0
        lamps.append(
            {"kind": "rectangle", "position_mm": centre, "direction": direction, "width_direction": across}
            | {"size_mm": [2 * HALF_MM, 2 * HALF_MM], "irradiance": 1.0, "reference_distance_mm": HALF_MM}
        )
    found = body_scene("box", {}, {"lights": lamps[:1]}).lighting.lamps_at(0.0)[0].area
    assert found is not None
    return [{**lamp, "irradiance": 1 / (math.pi * found.radiance)} for lamp in lamps]


def body_scene(body: str, material: dict[str, Any], lighting: dict[str, Any]) -> st.Scene:
    """Return the scene of a white body, whose camera is inside the lamps."""
    turned = {"position_mm": [0, 0, TARGET_MM], "rotations": [{"axis": [1, 2, 0.5], "angle_deg": 40}]}
    item = {"name": "body", "mesh": BODIES[body], "material": material, "pose": turned}
    return st.load_scene(
        {
            "camera": {"width": 32, "height": 24, "focal_length_px": 200},
            "stage": {"positions": 2, "baseline_mm": 1.0},
            "frames": {"count": 1},
            "render": {"backend": "raycast"},
            "objects": [item | {"texture": {"kind": "uniform", "radiance": 1.0}}],
            "lighting": lighting,
        }
    )


def image_of(scene: st.Scene) -> Floats:
    """Return the image of a scene."""
    with choose_renderer(scene, build_scene(scene)).renderer as renderer:
        return renderer.render(0.0, Viewpoint.on_axis(0.0)).astype(np.float64)


def furnace() -> None:
    """Print the radiance of white bodies in light that is equal from all directions."""
    print(heading(("body", "surface", "ambient light: least, largest", "six lamps: mean, least, largest")))
    lamps = walls()
    for body in BODIES:
        inside = image_of(body_scene(body, {}, {"ambient": 1.0})) > 1 - 1e-6
        # Without the pixels of the outline.
        for axis in (0, 1):
            inside &= np.roll(inside, 1, axis) & np.roll(inside, -1, axis)
        for name, material in SURFACES.items():
            ambient = image_of(body_scene(body, material, {"ambient": 1.0}))[inside]
            lit = image_of(body_scene(body, material, {"lights": lamps, "shadows": False}))[inside]
            cells = (f"{ambient.min():.7f}, {ambient.max():.7f}", f"{lit.mean():.4f}, {lit.min():.4f}, {lit.max():.4f}")
            print(line((body, name, *cells)), flush=True)


def closed_forms() -> None:
    """Print the differences of GGX reflection from its closed form and from integrals over the hemisphere."""
    worst = 0.0
    up = np.array([[0.0, 0.0, 1.0]])
    for rough in np.geomspace(0.03, 1.0, 40):
        material = Material(refractive_index=1.5, roughness=float(rough))
        _, gloss = reflect(material, up, up, once=True)
        worst = max(worst, abs(float(gloss[0]) / (0.04 / (4 * rough**2)) - 1))
    print(f"\nnormal incidence, 40 roughnesses from 0.03 to 1: largest relative difference {worst:.1e}")
    light, weights = hemisphere(250)
    largest = 0.0
    for material in (Material(refractive_index=1.5, roughness=0.2), Material(refractive_index=1.33, roughness=0.6)):
        table = albedo_tables(material.refractive_index, material.roughness, material.roughness)
        for node in (63, 50, 41, 30):
            cosine = (node / 63) ** 2
            camera = np.tile([math.sqrt(1 - cosine**2), 0.0, cosine], (len(light), 1))
            _, gloss = reflect(material, camera, light, once=True)
            largest = max(largest, abs(float(weights @ gloss) / float(table[node, 0]) - 1))
    print(f"directional albedo against integrals of the reflection: largest relative difference {largest:.1e}")


def threads() -> None:
    """Print whether images of one and two threads are equal."""
    scene = st.load_scene(SCENE, overrides=(*GLOSSY, RING, "camera.width=160", "camera.height=120"))
    found = []
    for count in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
        numba.set_num_threads(count)
        found.append(image_of(scene).tobytes())
    print(f"\nrosette, gloss, ring lamp: bytes of 1 and {count} threads equal: {found[0] == found[1]}")


def shares_of(scene: st.Scene, **patched: Any) -> tuple[Floats, Floats, Floats]:
    """Return the image, the shares of the first lamp at pixel centres, and what is known of the pixels.

    ``patched``: Attributes of `scenetruth.render.area_lamps`.
    """
    views: list[Any] = []
    begin = area_lamps.AreaLamps.begin

    def keep(self: area_lamps.AreaLamps, *given: Any) -> None:
        begin(self, *given)
        views.append(self._view)

    with ExitStack() as stack:
        stack.enter_context(mock.patch.object(area_lamps.AreaLamps, "begin", keep))
        for name, value in patched.items():
            stack.enter_context(mock.patch.object(area_lamps, name, value))
        image = image_of(scene)
    return image, views[0].shares[0], views[0].knowledge


def interpolation() -> None:
    """Print the errors of shares of light that are interpolated between pixels."""
    print()
    print(heading(("scene, lamp", "pixels in penumbrae", "shares beyond 2e-3, %", "largest difference")))
    for name, (file, changes) in PENUMBRAE.items():
        given = st.load_scene(file, overrides=changes)
        (_, found, knowledge), (_, computed, _) = shares_of(given), shares_of(given, _INTERPOLATED=-1.0)
        # Elsewhere, shares are not interpolated.
        kept = (knowledge == EXACT) | (knowledge == CLEAR)
        differs = np.abs(found - computed)[..., 0][kept]
        some = np.count_nonzero((computed[..., 0] > 0) & (computed[..., 0] < 1))
        print(line((name, some, f"{100 * np.mean(differs > FURTHER):.4f}", f"{differs.max():.1e}")), flush=True)
    scene = st.load_scene(SCENE, overrides=(*GLOSSY, RING))
    image, _, knowledge = shares_of(scene)
    wider = image_of(st.load_scene(SCENE, overrides=(*GLOSSY, RING, "camera.width=646")))
    with mock.patch.object(area_lamps.AreaLamps, "_view_of", return_value=None):
        exact = image_of(scene)
    rows = (
        ("light at every sample", np.abs(image - exact)),
        ("the same, without outlines", np.abs(image - exact)[knowledge != UNKNOWN]),
        ("the same points in an image of 646 px", np.abs(image - wider[:, 3:-3])),
    )
    print()
    print(heading(("image of the rosette under the ring, compared with", "pixels beyond 2e-3, %", "largest", "RMS")))
    for name, differs in rows:
        rms = np.sqrt(np.mean(differs**2))
        print(line((name, f"{100 * np.mean(differs > FURTHER):.4f}", f"{differs.max():.1e}", f"{rms:.1e}")))


def times() -> None:
    """Print the least processor time of an image of the variants of the rosette, which are rendered by turns."""
    renderers = {}
    for name, changes in CHANGES.items():
        scene = st.load_scene(SCENE, overrides=changes)
        renderers[name] = choose_renderer(scene, build_scene(scene)).renderer.__enter__()
    seconds: dict[str, list[float]] = {name: [] for name in CHANGES}
    for _ in range(ROUNDS + 1):
        for name, renderer in renderers.items():
            started = time.process_time()
            renderer.render(0.0, Viewpoint.on_axis(0.0))
            seconds[name].append(time.process_time() - started)
    least = {name: min(own[1:]) for name, own in seconds.items()}
    print()
    print(heading(("rosette, 640 x 480 px", "image, ms", "relative to the scene as bundled, with equal samples")))
    for name, own in least.items():
        same = "as bundled, 3 x 3 samples" if name.endswith("3 x 3 samples") else "as bundled"
        print(line((name, f"{1e3 * own:.0f}", f"{own / least[same]:.1f}")))


def main() -> None:
    """Print all tables."""
    furnace()
    closed_forms()
    threads()
    interpolation()
    times()


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
