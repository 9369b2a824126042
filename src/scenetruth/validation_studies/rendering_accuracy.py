"""The accuracy of rendered images compared with the exact pixel integral, at subpixel shifts."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from scenetruth.bands import as_number
from scenetruth.camera import Viewpoint
from scenetruth.errors import BackendUnavailableError
from scenetruth.progress import Progress
from scenetruth.random_streams import generator_for
from scenetruth.render import Renderer
from scenetruth.scene import Scene
from scenetruth.scene.built_scene import BuiltScene, build_scene
from scenetruth.scene.mesh.sheets import PlaneMesh
from scenetruth.scene.texture.band_limited_noise import make_band_limited_noise
from scenetruth.scene.texture.procedural_textures import NoiseTexture
from scenetruth.validation_studies.csv_tables import write_table

__all__ = [
    "SHIFTS_PX",
    "TEXTURES_PX",
    "PlaneImage",
    "RenderingAccuracy",
    "RenderingMeasurement",
    "noise_plane",
    "reference_image",
    "run_fidelity",
    "shift_errors",
]


Field = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlaneImage:
    """The exact image of a plane with a noise texture, seen perpendicularly.

    Band-limited noise on a periodic raster is a finite Fourier series, determined by its samples. Its mean over the
    square footprint of a pixel of pitch p is the series with every wave multiplied by sinc(k_x p) sinc(k_y p), where k
    is in cycles per length; neither quadrature nor interpolation is necessary.

    ``spectrum``: Amplitudes of the waves exp(2πi (k_y Y / P_y + k_x X / P_x)) of the radiance, shape (rows, columns).
    ``wave_numbers``: Integers k_y, shape (rows,), and k_x, shape (columns,).
    ``period_mm``: (P_x, P_y). ``pitch_mm``: Distance of neighbouring pixels on the plane.
    ``first_mm``: Position (X, Y) of the first pixel's centre on the texture, from the corner of its first texel.
    """

    spectrum: NDArray[np.complex128]
    wave_numbers: tuple[Field, Field]
    period_mm: tuple[float, float]
    pitch_mm: float
    first_mm: tuple[float, float]
    shape: tuple[int, int]

    @classmethod
    def of_raster(
        cls,
        values: NDArray[np.float32],
        mean: float,
        std: float,
        *,
        period_mm: tuple[float, float],
        shortest_mm: float,
        pitch_mm: float,
        first_mm: tuple[float, float],
        shape: tuple[int, int],
    ) -> Self:
        """Return the series of noise (mean 0, variance 1) from its values at texels (j + 1/2, i + 1/2), (h, w)."""
        rows, columns = values.shape
        k_y, k_x = fft.fftfreq(rows, 1 / rows), fft.fftfreq(columns, 1 / columns)
        inside = [np.abs(k) <= np.floor(p / shortest_mm) for k, p in ((k_y, period_mm[1]), (k_x, period_mm[0]))]
        k_y, k_x = k_y[inside[0]], k_x[inside[1]]
        spectrum = std * fft.fft2(values.astype(np.float64))[np.ix_(*inside)] / values.size
        # The first sample is half a texel from the corner.
        spectrum *= np.exp(-1j * np.pi * k_y / rows)[:, None] * np.exp(-1j * np.pi * k_x / columns)
        spectrum[np.ix_(k_y == 0, k_x == 0)] = mean
        return cls(spectrum, (k_y, k_x), period_mm, pitch_mm, first_mm, shape)

    def values(self, shift_px: float = 0.0) -> Field:
        """Return the exact image, the mean radiance over the pixel footprints, float64, shape (height, width)."""
        return self._sum(self.spectrum * self._footprint(), shift_px)

    def points(self, shift_px: float = 0.0, offset_px: tuple[float, float] = (0.0, 0.0)) -> Field:
        """Return the radiance at one point of each pixel, float64, shape (height, width)."""
        return self._sum(self.spectrum, shift_px, offset_px)

    def gradient(self, shift_px: float = 0.0) -> tuple[Field, Field]:
        """Return the derivatives of `values` per pixel to the right and downwards, shape (height, width) each."""
        (k_y, k_x), spectrum = self.wave_numbers, self.spectrum * self._footprint()
        across, down = (2j * np.pi * self.pitch_mm / period for period in self.period_mm)
        return self._sum(spectrum * (across * k_x), shift_px), self._sum(spectrum * (down * k_y)[:, None], shift_px)

    def _footprint(self) -> Field:
        (k_y, k_x), pitch = self.wave_numbers, self.pitch_mm
        return np.sinc(k_y * pitch / self.period_mm[1])[:, None] * np.sinc(k_x * pitch / self.period_mm[0])

    def _sum(
        self, spectrum: NDArray[np.complex128], shift_px: float, offset_px: tuple[float, float] = (0.0, 0.0)
    ) -> Field:
        """Return the sum of the waves at all pixels; the pixel grid reduces it to two matrix products."""
        height, width = self.shape
        (k_y, k_x), (period_x, period_y) = self.wave_numbers, self.period_mm
        x = self.first_mm[0] + (np.arange(width) - shift_px + offset_px[0]) * self.pitch_mm
        y = self.first_mm[1] + (np.arange(height) + offset_px[1]) * self.pitch_mm
        waves_x = np.exp(2j * np.pi * np.outer(k_x, x / period_x))
        waves_y = np.exp(2j * np.pi * np.outer(y / period_y, k_y))
        return np.asarray((waves_y @ spectrum @ waves_x).real)


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


_FOCAL_LENGTH_PX = 5016.0
_DEPTH_MM = 660.0
_MARGIN_PX = 8  # of the plane around the image at every shift, to exclude silhouettes
_PITCH_MM = _DEPTH_MM / _FOCAL_LENGTH_PX
_OBJECT = "plane"


def noise_plane(wavelength_px: tuple[float, float], shape: tuple[int, int]) -> Scene:
    """Return a noise plane at 660 mm that fills the image and moves to the right by one pixel per frame.

    ``wavelength_px``: Shortest and longest wavelength in px of the image.
    """
    height, width = shape
    return Scene.from_dict(
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

    The noise is generated from the scene's seed, independent of the splines and texture coordinates of the renderers.
    """
    item = scene.objects[0]
    assert isinstance(item.texture, NoiseTexture)
    assert isinstance(item.mesh, PlaneMesh)
    entry, (plane_width, plane_height) = item.texture, item.mesh.size_mm
    noise = make_band_limited_noise(
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
) -> tuple[list[RenderingAccuracy], str]:
    """Measure all available backends; write ``fidelity.csv``, ``.json`` and ``.png``, and ``fidelity_maps.png``."""
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
    write_table(folder / "fidelity.csv", _rows(results))
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
        "depth_mm": _DEPTH_MM,
        "focal_length_px": _FOCAL_LENGTH_PX,
        "image": {"height": shape[0], "width": shape[1]},
        "wavelengths_px": TEXTURES_PX,
        "shifts_px": SHIFTS_PX,
        "subset_px": SUBSET_PX,
    }
    content = {"protocol": protocol, "pyrender_left_out": reason or None, "results": _rows(results)}
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
