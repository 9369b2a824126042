"""The accuracy of rendered images compared with the exact pixel integral, at subpixel shifts."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenetruth.bands import as_number
from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.progress import Progress
from scenetruth.render import Renderer
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.texture.procedural_textures import NoiseTexture
from scenetruth.validation_studies.noise_plane import DEPTH_MM, FOCAL_LENGTH_PX, noise_plane, reference_image

__all__ = [
    "SHIFTS_PX",
    "TEXTURES_PX",
    "RenderingAccuracy",
    "RenderingMeasurement",
    "run_fidelity",
    "shift_errors",
]


def shift_errors(
    image: NDArray[np.float32] | NDArray[np.float64],
    exact: NDArray[np.float64],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
    subset_px: int,
) -> NDArray[np.float64]:
    """Return the shifts (x, y) of an image relative to the exact image in px, (rows, columns, 2), in square subsets.

    A shift by e to the right gives the grey values exact(x - e) ≈ exact - e d exact/dx. The least-squares solution for
    e, with analytic derivatives, is one Gauss-Newton step; the neglected second-order terms, about e² over the
    wavelength, are insignificant for shifts of 1e-3 px. Gain and offset are not adjusted and count as error.
    """
    rows, columns = (side // subset_px for side in exact.shape)

    def sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
        used = values[: rows * subset_px, : columns * subset_px]
        return np.asarray(used.reshape(rows, subset_px, columns, subset_px).sum(axis=(1, 3)))

    difference = exact - image
    xx, xy, yy = sums(across * across), sums(across * down), sums(down * down)
    x, y = sums(across * difference), sums(down * difference)
    determinant = xx * yy - xy * xy
    return np.stack([(yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant], axis=-1)


BOUNDS_PX = {"pyrender": 5e-4, "raycast": 1e-4}
"""Upper bound of the RMS shift error, px: band-limited texture, 4 x 4 samples; ten times as much for the maximum."""


@dataclass(frozen=True)
class RenderingAccuracy:
    """The errors of one backend with one number of samples.

    ``texture``: Key of `TEXTURES_PX`. ``supersampling``: n, of n x n samples.
    ``rms_px``, ``max_px``: Of the shift errors of all registered subsets over all shifts, x and y together.
    ``rms_grey``, ``max_grey``: Of rendered minus exact grey values, in units of the texture's standard deviation.
    ``seconds_per_image``: Median over the shifts.
    """

    texture: str
    shortest_wavelength_px: float
    backend: str
    supersampling: int
    subsets: int
    rms_px: float
    max_px: float
    rms_grey: float
    max_grey: float
    seconds_per_image: float

    @property
    def bound_px(self) -> float | None:
        """Upper bound of the RMS shift error, or None if `BOUNDS_PX` has none."""
        if self.texture != "band-limited" or self.supersampling != 4:
            return None
        return BOUNDS_PX[self.backend.split()[0]]

    @property
    def within_bounds(self) -> bool | None:
        """Whether RMS and maximum are within the bound; None if there is no bound."""
        bound = self.bound_px
        return None if bound is None else self.rms_px <= bound and self.max_px <= 10 * bound


@dataclass(frozen=True, eq=False)
class RenderingMeasurement:
    """A result and the shift errors (x, y) of every subset, shape (shifts, rows, columns, 2)."""

    result: RenderingAccuracy
    errors_px: NDArray[np.float64]


# Okabe and Ito's colours, with a marker each.
_STYLES = {"pyrender": ("#0072B2", "o"), "raycast": ("#D55E00", "s")}


def draw_errors(results: Sequence[RenderingAccuracy], file: Path) -> None:
    """Draw shift errors and grey-value errors over the number of samples, a column for each texture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    textures = list(dict.fromkeys(result.texture for result in results))
    figure = Figure(figsize=(5.5 * len(textures), 8.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(textures), sharex=True, sharey="row", squeeze=False)
    for column, texture in enumerate(textures):
        above, below = axes[0][column], axes[1][column]
        chosen = [result for result in results if result.texture == texture]
        for backend in dict.fromkeys(result.backend for result in chosen):
            line = [result for result in chosen if result.backend == backend]
            colour, marker = _STYLES[backend.split()[0]]
            n = [result.supersampling for result in line]
            style: dict[str, Any] = {"color": colour, "marker": marker, "markersize": 5}
            above.plot(n, [result.rms_px for result in line], label=f"{backend}, RMS", **style)
            above.plot(n, [result.max_px for result in line], label="largest", linestyle=":", **style)
            below.plot(n, [result.rms_grey for result in line], label=f"{backend}, RMS", **style)
            for result in line:
                if result.bound_px is not None:
                    label = f"bound of RMS, {backend.split()[0]}"
                    above.plot([2.8, 5.7], [result.bound_px] * 2, "--", color=colour, linewidth=2, label=label)
        shortest = chosen[0].shortest_wavelength_px
        above.set_title(f"{texture}: wavelengths from {shortest:g} px", loc="left", fontsize=11)
        below.set_xlabel("n, of n x n samples per pixel")
        for ax in (above, below):
            ax.set(xscale="log", yscale="log")
            ax.set_xticks(sorted({result.supersampling for result in results}))
            ax.get_xaxis().set_major_formatter("{x:g}")
            ax.minorticks_off()
            ax.grid(alpha=0.3)
            ax.legend(fontsize=9)
    axes[0][0].set_ylabel("shift error of 25 x 25 px subsets, px")
    axes[1][0].set_ylabel("grey-value error / std of the texture")
    figure.suptitle("Rendered images compared with the exact pixel integral", fontsize=12)
    figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})


def draw_maps(measured: Sequence[RenderingMeasurement], file: Path) -> None:
    """Draw maps of the shift errors of the subsets for the band-limited texture, as RMS over all shifts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    chosen = [one for one in measured if one.result.texture == "band-limited"]
    maps = {
        (one.result.backend, one.result.supersampling): np.sqrt(np.mean(one.errors_px**2, axis=(0, 3)))
        for one in chosen
    }
    backends, samplings = (list(dict.fromkeys(keys)) for keys in zip(*maps, strict=True))
    figure = Figure(figsize=(3.4 * len(samplings) + 1, 2.9 * len(backends) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(backends), len(samplings), squeeze=False)
    norm = LogNorm(min(float(one.min()) for one in maps.values()), max(float(one.max()) for one in maps.values()))
    for row, backend in enumerate(backends):
        for column, n in enumerate(samplings):
            ax: Any = axes[row][column]
            shown = ax.imshow(maps[backend, n], norm=norm, cmap="viridis")
            ax.set_title(f"{backend}, {n} x {n}", fontsize=10)
            ax.set(xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes, label="RMS shift error over all shifts, px", shrink=0.9)
    figure.suptitle("Shift errors of each 25 x 25 px subset, wavelengths from 6 px", fontsize=12)
    figure.savefig(file, dpi=110, metadata={"Software": "scenetruth"})


TEXTURES_PX = {"band-limited": (6.0, 30.0), "beyond Nyquist": (1.0, 30.0)}
"""Shortest and longest wavelength of the textures, in px of the image."""
SHIFTS_PX = tuple(round(0.1 * step, 1) for step in range(11))
"""Shifts of the plane to the right, px."""

SAMPLINGS = (1, 2, 4, 8)
SUBSET_PX = 25
"""Side of the square subsets for registration."""


def run_fidelity(
    folder: Path,
    *,
    samplings: Sequence[int] = SAMPLINGS,
    shape: tuple[int, int] = (475, 625),
    platform: str = "auto",
    progress: Progress | None = None,
) -> tuple[list[RenderingAccuracy], str]:
    """Measure all available backends; write ``fidelity.csv``, ``.json`` and ``.png``, and ``fidelity_maps.png``."""
    import pandas as pd

    openers, reason = _openers(platform)
    shape = (max(shape[0], SUBSET_PX), max(shape[1], SUBSET_PX))
    total = len(TEXTURES_PX) * len(openers) * len(samplings)
    measured: list[RenderingMeasurement] = []
    for texture, wavelength in TEXTURES_PX.items():
        scene = noise_plane(wavelength, shape)
        exact = [
            (image.values(shift), *image.gradient(shift)) for image in (reference_image(scene),) for shift in SHIFTS_PX
        ]
        world = build_scene(scene)
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
    pd.DataFrame(_rows(results)).to_csv(folder / "fidelity.csv", index=False)
    _write_json(results, reason, shape, folder / "fidelity.json")

    draw_errors(results, folder / "fidelity.png")
    draw_maps(measured, folder / "fidelity_maps.png")
    return results, reason


Opener = Callable[[BuiltScene, Scene, int], Renderer]


def _openers(platform: str) -> tuple[list[Opener], str]:
    """Return the openers of the available backends, and the reason if pyrender is unavailable."""
    from scenetruth.render.opengl import use_platform
    from scenetruth.render.pyrender_backend import PyrenderRenderer
    from scenetruth.render.raycast_backend import RaycastRenderer

    openers: list[Opener] = [
        lambda world, scene, n: RaycastRenderer(world, scene.camera, as_number(scene.background), n)
    ]
    try:
        use_platform(platform)
    except BackendUnavailableError as error:
        return openers, str(error)
    return [
        lambda world, scene, n: PyrenderRenderer(world, scene.camera, as_number(scene.background), n, platform),
        *openers,
    ], ""


def _measure(
    texture: str,
    scene: Scene,
    renderer: Renderer,
    n: int,
    exact: Sequence[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]],
) -> RenderingMeasurement:
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
    return RenderingMeasurement(
        RenderingAccuracy(
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


def _rows(results: Sequence[RenderingAccuracy]) -> list[dict[str, Any]]:
    return [
        {**asdict(result), "bound_px": result.bound_px, "within_bounds": result.within_bounds} for result in results
    ]


def _write_json(results: Sequence[RenderingAccuracy], reason: str, shape: tuple[int, int], file: Path) -> None:
    protocol = {
        "depth_mm": DEPTH_MM,
        "focal_length_px": FOCAL_LENGTH_PX,
        "image": {"height": shape[0], "width": shape[1]},
        "wavelengths_px": TEXTURES_PX,
        "shifts_px": SHIFTS_PX,
        "subset_px": SUBSET_PX,
    }
    content = {"protocol": protocol, "pyrender_left_out": reason or None, "results": _rows(results)}
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
