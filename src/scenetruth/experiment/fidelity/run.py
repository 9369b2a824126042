"""The fidelity of rendered images to the pixel integral: errors of sub-pixel shifts and of grey values."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.experiment.fidelity.reference import PlaneImage
from scenetruth.experiment.fidelity.registration import shift_errors
from scenetruth.experiment.fidelity.results import BOUNDS_PX, Fidelity, Measurement
from scenetruth.experiment.tables import write_table
from scenetruth.progress import Progress
from scenetruth.randomness import generator_for
from scenetruth.render import Renderer
from scenetruth.scene import Scene, scene_from_plain
from scenetruth.scene.mesh.plane import PlaneMesh
from scenetruth.scene.texture.band_limited import band_limited_noise
from scenetruth.scene.texture.noise import NoiseTexture
from scenetruth.scene.world import World, build_world

__all__ = [
    "BOUNDS_PX",
    "SHIFTS_PX",
    "SUBSET_PX",
    "TEXTURES_PX",
    "Fidelity",
    "Measurement",
    "noise_plane",
    "reference_image",
    "run_fidelity",
]

TEXTURES_PX = {"band-limited": (6.0, 30.0), "beyond Nyquist": (1.0, 30.0)}
"""Shortest and longest wavelength of the textures, in px of the image."""

SHIFTS_PX = tuple(round(0.1 * step, 1) for step in range(11))
"""How far the plane moves to the right."""

SAMPLINGS = (1, 2, 4, 8)
SUBSET_PX = 25
"""Edge of the square subsets that are registered."""


_FOCAL_LENGTH_PX = 5016.0
_DEPTH_MM = 660.0
_MARGIN_PX = 8  # of the plane around the image, at every shift: no silhouette takes part
_PITCH_MM = _DEPTH_MM / _FOCAL_LENGTH_PX
_OBJECT = "plane"


def noise_plane(wavelength_px: tuple[float, float], shape: tuple[int, int]) -> Scene:
    """Return a noise plane at 660 mm that fills the image, and moves to the right by one pixel per frame.

    Parameters
    ----------
    wavelength_px
        Shortest and longest wavelength in px of the image.
    shape
        (height, width) of the image.

    Returns
    -------
    Scene
        The scene, with one frame and one camera position.
    """
    height, width = shape
    return scene_from_plain(
        {
            "camera": {"width": width, "height": height, "focal_length_px": _FOCAL_LENGTH_PX},
            "stage": {"positions": 1, "baseline_mm": 1.0},
            "frames": {"count": 1},
            "objects": [
                {
                    "name": _OBJECT,
                    "mesh": {
                        "kind": "plane",
                        "size_mm": [(side + 2 * _MARGIN_PX) * _PITCH_MM for side in (width, height)],
                    },
                    "pose": {"position_mm": [0, 0, _DEPTH_MM]},
                    "texture": {"kind": "noise", "wavelength_mm": [length * _PITCH_MM for length in wavelength_px]},
                    "motion": [{"kind": "velocity", "velocity_mm_per_frame": [_PITCH_MM, 0, 0]}],
                }
            ],
            "seed": 2002,
        }
    )


def reference_image(scene: Scene) -> PlaneImage:
    """Return the exact image of a noise plane, from the Fourier series of its noise and the projection.

    The noise is made anew from the scene's seed. No spline and no texture coordinate of the renderers is used.

    Parameters
    ----------
    scene
        What `noise_plane` returned.

    Returns
    -------
    PlaneImage
        The image, for any shift of the plane.
    """
    item = scene.objects[0]
    assert isinstance(item.texture, NoiseTexture)
    assert isinstance(item.mesh, PlaneMesh)
    entry, (plane_width, plane_height) = item.texture, item.mesh.size_mm
    noise = band_limited_noise(
        entry.wavelength_mm,
        (plane_width, plane_height),
        generator_for(scene.seed, "texture", item.name),
        exponent=entry.spectrum_exponent,
        peak=entry.peak,
    )
    width, height = scene.camera.width, scene.camera.height
    first = [(plane - (side - 1) * _PITCH_MM) / 2 for plane, side in ((plane_width, width), (plane_height, height))]
    return PlaneImage.of_raster(
        noise.values,
        entry.mean,
        entry.mean * entry.rms_contrast,
        period_mm=noise.period,
        shortest_mm=entry.wavelength_mm[0],
        pitch_mm=_PITCH_MM,
        first_mm=(first[0], first[1]),
        shape=(height, width),
    )


def run_fidelity(
    folder: Path,
    *,
    samplings: Sequence[int] = SAMPLINGS,
    shape: tuple[int, int] = (475, 625),
    platform: str = "auto",
    progress: Progress | None = None,
) -> tuple[list[Fidelity], str]:
    """Measure every backend that runs here, and write tables and pictures.

    Files: ``fidelity.csv``, ``fidelity.json``, ``fidelity.png`` and ``fidelity_maps.png``.

    Parameters
    ----------
    folder
        Where; it is made.
    samplings
        Numbers n of n x n samples.
    shape
        (height, width) of the images; at least one subset.
    platform
        OpenGL platform of ``pyrender``: ``"auto"``, ``"osmesa"`` or ``"egl"``. A process can use one only.
    progress
        Called with (what, done, total).

    Returns
    -------
    tuple
        The results, and why ``pyrender`` was left out (empty if it was not).
    """
    openers, reason = _openers(platform)
    shape = (max(shape[0], SUBSET_PX), max(shape[1], SUBSET_PX))
    total = len(TEXTURES_PX) * len(openers) * len(samplings)
    measured: list[Measurement] = []
    for texture, wavelength in TEXTURES_PX.items():
        scene = noise_plane(wavelength, shape)
        exact = [
            (image.values(shift), *image.gradient(shift)) for image in (reference_image(scene),) for shift in SHIFTS_PX
        ]
        world = build_world(scene)
        for open_renderer in openers:
            for n in samplings:
                if progress is not None:
                    progress("fidelity", len(measured), total)
                with open_renderer(world, scene, n) as renderer:
                    measured.append(_measure(texture, scene, renderer, n, exact))
    if progress is not None:
        progress("fidelity", total, total)
    results = [one.result for one in measured]
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "fidelity.csv", _rows(results))
    _write_json(results, reason, shape, folder / "fidelity.json")
    from scenetruth.experiment.fidelity.pictures import draw_errors, draw_maps

    draw_errors(results, folder / "fidelity.png")
    draw_maps(measured, folder / "fidelity_maps.png")
    return results, reason


Opener = Callable[[World, Scene, int], Renderer]


def _openers(platform: str) -> tuple[list[Opener], str]:
    """Return what opens each backend that runs here, and why pyrender does not."""
    from scenetruth.render.opengl import use_platform
    from scenetruth.render.pyrender_backend import PyrenderRenderer
    from scenetruth.render.raycast_backend import RaycastRenderer

    openers: list[Opener] = [lambda world, scene, n: RaycastRenderer(world, scene.camera, scene.background, n)]
    try:
        use_platform(platform)
    except BackendUnavailableError as error:
        return openers, str(error)
    return [lambda world, scene, n: PyrenderRenderer(world, scene.camera, scene.background, n, platform), *openers], ""


def _measure(
    texture: str,
    scene: Scene,
    renderer: Renderer,
    n: int,
    exact: Sequence[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]],
) -> Measurement:
    item = scene.objects[0].texture
    assert isinstance(item, NoiseTexture)
    viewpoint = Viewpoint.on_axis(0.0)
    renderer.render(0.0, viewpoint)  # compiles and uploads, untimed
    seconds, errors, grey = [], [], []
    for shift, (values, across, down) in zip(SHIFTS_PX, exact, strict=True):
        start = time.perf_counter()
        image = renderer.render(shift, viewpoint)
        seconds.append(time.perf_counter() - start)
        errors.append(shift_errors(image, values, across, down, SUBSET_PX))
        grey.append((image - values) / (item.mean * item.rms_contrast))
    stacked = np.stack(errors)
    return Measurement(
        Fidelity(
            texture=texture,
            shortest_wavelength_px=TEXTURES_PX[texture][0],
            backend=renderer.name,
            supersampling=n,
            subsets=stacked[..., 0].size,
            rms_px=float(np.sqrt(np.mean(stacked**2))),
            max_px=float(np.abs(stacked).max()),
            rms_grey=float(np.sqrt(np.mean(np.square(grey)))),
            max_grey=float(np.abs(grey).max()),
            seconds_per_image=float(np.median(seconds)),
        ),
        stacked,
    )


def _rows(results: Sequence[Fidelity]) -> list[dict[str, Any]]:
    return [
        {**asdict(result), "bound_px": result.bound_px, "within_bounds": result.within_bounds} for result in results
    ]


def _write_json(results: Sequence[Fidelity], reason: str, shape: tuple[int, int], file: Path) -> None:
    protocol = {
        "depth_mm": _DEPTH_MM,
        "focal_length_px": _FOCAL_LENGTH_PX,
        "image": {"height": shape[0], "width": shape[1]},
        "wavelengths_px": TEXTURES_PX,
        "shifts_px": SHIFTS_PX,
        "subset_px": SUBSET_PX,
    }
    content = {"protocol": protocol, "pyrender_left_out": reason or None, "results": _rows(results)}
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
