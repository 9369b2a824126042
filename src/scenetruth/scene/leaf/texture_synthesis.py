"""Synthesis of leaf textures: veins, nets between them, mottling and hairs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenetruth.cache import entry_key, load_or_compute, source_hash
from scenetruth.errors import Problem, SceneError
from scenetruth.number_format import format_two_digits
from scenetruth.scene.leaf.leaf_model import LeafAppearance, LeafForm
from scenetruth.scene.leaf.margin import compute_entire_margin
from scenetruth.scene.leaf.veins import Vein, make_main_veins, make_side_veins
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.texture import Painted
from scenetruth.scene.texture import band_limited_noise as band_limited
from scenetruth.scene.texture.band_limited_noise import make_band_limited_noise

__all__ = ["LeafPainting", "LeafTexture"]


Floats = NDArray[np.float64]
Image = NDArray[np.float32]

_FWHM = 2 * float(np.sqrt(2 * np.log(2)))
_SHARPEST = 1.2  # texels: standard deviation of the thinnest lines,
_BLUR = 1.0  # and of the Gaussian smoothing of all drawn veins
_DOT = 1.5  # texels: standard deviation of the smallest dots
_MOST_TEXELS = 64_000_000
_MOST_BY_DEFAULT = 4_000_000
_MOST_DOTS = 5_000_000
_MOST_LAYERS = 10
_EDGE_TEXELS = 8
_PEAK = 4.0  # maximum of the mottling in standard deviations
_LADDER = (0.58, 0.0034)  # strength and width relative to the leaf length, of the tertiary veins,
_AREOLES = (0.32, 0.0019)  # and of the finest network
_HALO = (0.10, 0.014)  # strength and width of the halo around large veins


@dataclass(frozen=True, eq=False)
class LeafPainting:
    """Both sides of a leaf as one periodic cubic B-spline, shape (h, w): upper side left, mirrored underside right."""

    coefficients: Image
    tiled: bool = True
    cubic: bool = True

    def radiance(self, uv: Floats) -> Image:
        """Return the radiance at texture coordinates of shape (n, 2)."""
        from scenetruth.scene.texture.texture_kernels import spline_lookup

        values: Image = spline_lookup(self.coefficients, np.ascontiguousarray(uv))
        return values

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> Image:
        """Return weighted means over footprints, see `SurfaceTexture`."""
        from scenetruth.scene.texture.texture_kernels import spline_means

        means: Image = spline_means(self.coefficients, forms, offsets, weights)
        return means

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the raster."""
        return self.coefficients.shape[0], self.coefficients.shape[1]

    def raster(self) -> Image:
        """Return the coefficients."""
        return self.coefficients


@dataclass(frozen=True, eq=False)
class _Canvas:
    """Raster of one side: texel (i, j) is at low + (j + 1/2, i + 1/2) / texels_per_mm."""

    low_mm: tuple[float, float]
    shape: tuple[int, int]
    texels_per_mm: float

    @property
    def size_mm(self) -> tuple[float, float]:
        return self.shape[1] / self.texels_per_mm, self.shape[0] / self.texels_per_mm

    def compute_texels(self, points_mm: Floats) -> Floats:
        return (points_mm - self.low_mm) * self.texels_per_mm - 0.5

    def places(self) -> tuple[Image, Image]:
        """Return a and b of all texels."""
        a = (np.arange(self.shape[1]) + 0.5) / self.texels_per_mm + self.low_mm[0]
        b = (np.arange(self.shape[0]) + 0.5) / self.texels_per_mm + self.low_mm[1]
        both = np.broadcast_arrays(a[None].astype(np.float32), b[:, None].astype(np.float32))
        return both[0], both[1]


def paint_leaf(
    entry: LeafAppearance, mesh: TriangleMesh, generator: np.random.Generator
) -> tuple[LeafPainting, Floats, Floats]:
    """Return the texture of a leaf, and the texture coordinates of upper side and underside, shape (m, 3, 2) each."""
    leaf = _get_leaf_form(entry, mesh)
    canvas = _canvas(entry, leaf)
    key = compute_painting_key(entry, mesh, generator)
    found = load_or_compute(key, lambda: {"coefficients": _painted(entry, leaf, canvas, generator)})
    uv = (mesh.chart_mm - canvas.low_mm) / canvas.size_mm * (0.5, 1.0)
    back = uv * (-1, 1) + (1, 0)
    return LeafPainting(found["coefficients"]), uv, back


def compute_painting_shape(entry: LeafAppearance, mesh: TriangleMesh) -> tuple[int, int]:
    """Return the rows and columns of the raster of both sides."""
    rows, columns = _canvas(entry, _get_leaf_form(entry, mesh)).shape
    return rows, 2 * columns


def compute_painting_key(entry: LeafAppearance, mesh: TriangleMesh, generator: np.random.Generator) -> str:
    """Return the cache key of the raster."""
    leaf, state = _get_leaf_form(entry, mesh), generator.bit_generator.state
    sources = source_hash(Path(__file__).parent, Path(band_limited.__file__).parent)
    return entry_key("leaf", sources, entry.model_dump(mode="json"), leaf.model_dump(mode="json"), state)


def _get_leaf_form(entry: LeafAppearance, mesh: TriangleMesh) -> LeafForm:
    leaf = mesh.source
    if not isinstance(leaf, LeafForm):
        message = "requires a mesh with `kind` leaf; use a noise, image, plaid or uniform texture"
        raise SceneError([Problem("kind", message, entry.kind)])
    return leaf


def _painted(entry: LeafAppearance, leaf: LeafForm, canvas: _Canvas, generator: np.random.Generator) -> Image:
    """Return the spline coefficients of both sides."""
    values = entry.settings
    veins = _veins(entry, leaf, canvas, generator)
    sides = []
    for lightness, relief in ((1.0, 1.0), (values["underside_lightness"], entry.underside_relief)):
        side = 1 + np.float32(values["vein_contrast"] * relief) * veins
        if values["mottling_contrast"] > 0:
            side += np.float32(values["mottling_contrast"]) * _mottling(entry, canvas, generator)
        if values["speckle_contrast"] > 0 and entry.speckle_density_per_mm2 > 0:
            side += np.float32(values["speckle_contrast"]) * _speckle(entry, canvas, generator)
        side *= np.float32(values["mean"] * lightness)
        sides.append(side)
    return _spline(np.concatenate([sides[0], sides[1][:, ::-1]], axis=1))


def _canvas(entry: LeafAppearance, leaf: LeafForm) -> _Canvas:
    behind = -float(compute_entire_margin(leaf)[:, 0].min())
    if leaf.petiole is not None:
        behind = max(behind, leaf.petiole.length_mm)
    length, width = leaf.length_mm + behind, leaf.full_width_mm
    finest = entry.mottling_wavelength_mm[0]
    density = entry.texels_per_mm
    if density is None:
        wanted = max(8 / finest, _DOT * _FWHM / entry.speckle_size_mm)
        density = max(4 / finest, min(wanted, float(np.sqrt(_MOST_BY_DEFAULT / (2 * length * width)))))
    if density < 4 / finest:
        message = f"must be at least {4 / finest:.4g}, four per shortest wavelength of the mottling"
        raise SceneError([Problem("texels_per_mm", message, density)])
    if 2 * length * width * density**2 > _MOST_TEXELS:
        most = float(np.sqrt(_MOST_TEXELS / (2 * length * width)))
        message = f"gives more than 64 million texels; the maximum for this leaf is {most:.3g}, and the mottling's "
        message += f"shortest wavelength must be at least {4 / most:.3g} mm"
        raise SceneError([Problem("texels_per_mm", message, density)])
    _refuse_fine_details(entry, leaf, length * width, density)
    edge = _EDGE_TEXELS / density
    shape = (int(np.ceil((width + 2 * edge) * density)), int(np.ceil((length + 2 * edge) * density)))
    return _Canvas((-behind - edge, -width / 2 - edge), shape, density)


def _refuse_fine_details(entry: LeafAppearance, leaf: LeafForm, area_mm2: float, density: float) -> None:
    """Raise a SceneError for too many or overlapping dots, or for a network finer than the raster."""
    dots, spread = entry.speckle_density_per_mm2 * area_mm2, entry.speckle_density_per_mm2 * entry.speckle_size_mm**2
    if dots > _MOST_DOTS:
        message = f"gives {format_two_digits(dots)} dots, more than {_MOST_DOTS:.0e}; reduce it"
        raise SceneError([Problem("speckle_density_per_mm2", message, entry.speckle_density_per_mm2)])
    if spread > _MOST_LAYERS:
        message = f"gives {spread:.3g} overlapping dots everywhere; use smaller or fewer dots"
        raise SceneError([Problem("speckle_size_mm", message, entry.speckle_size_mm)])
    spacing = entry.tertiary_spacing_mm
    if spacing is not None and spacing * density < 1:
        message = f"is less than a texel of the raster, {1 / density:.3g} mm; increase it"
        raise SceneError([Problem("tertiary_spacing_mm", message, spacing)])


def _veins(entry: LeafAppearance, leaf: LeafForm, canvas: _Canvas, generator: np.random.Generator) -> Image:
    """Return all veins relative to the contrast of the midrib, 0 to 1."""
    from scipy.ndimage import gaussian_filter

    side_veins = make_side_veins(leaf, entry, generator)
    midrib, large = np.zeros(canvas.shape, dtype=np.float32), np.zeros(canvas.shape, dtype=np.float32)
    for vein in make_main_veins(leaf):
        _draw(midrib, vein, canvas)
    for vein in side_veins:
        _draw(large, vein, canvas)
    ladder, areoles = _nets(entry, leaf, canvas, generator)
    fine = np.maximum(ladder, areoles)
    # Nothing is drawn in the petiole, and large veins cover small veins.
    fine *= (1 - large) * (1 - midrib) ** 2
    drawn = gaussian_filter(np.maximum(np.maximum(midrib, large), fine), _BLUR, mode="nearest")
    spread = _HALO[1] * leaf.length_mm * canvas.texels_per_mm
    light = gaussian_filter(np.maximum(midrib, large), spread, mode="nearest", truncate=3.0)
    veins: Image = drawn + np.float32(_HALO[0]) * light * (1 - drawn)
    return veins


def _draw(raster: Image, vein: Vein, canvas: _Canvas) -> None:
    from scenetruth.scene.leaf.leaf_kernels import draw_veins

    sigmas = np.maximum(vein.width_mm * canvas.texels_per_mm / _FWHM, _SHARPEST)
    draw_veins(raster, canvas.compute_texels(vein.points_mm), sigmas, vein.strength)


def _nets(
    entry: LeafAppearance, leaf: LeafForm, canvas: _Canvas, generator: np.random.Generator
) -> tuple[Image, Image]:
    """Return the tertiary veins (rungs between secondary veins) and the finest network."""
    from scenetruth.scene.leaf.leaf_kernels import net

    spacing = entry.tertiary_spacing_mm or 0.035 * leaf.length_mm
    a, b = canvas.places()
    across, along = (_warp(spacing, canvas, generator) for _ in range(2))
    # Positions along and across the secondary veins, which leave the midrib at an angle and bend towards the tip.
    angle = np.radians(entry.secondary_angle_deg)
    ahead, out, number = _beside_veins(leaf, a, b, across)
    rung = (ahead - out / np.float32(np.tan(angle)) - np.float32(0.55 / leaf.full_width_mm) * out**2) * np.sin(angle)
    far = out / np.float32(np.sin(angle)) + np.float32(53.7 * spacing) * number
    texel = 1 / canvas.texels_per_mm
    layers = []
    for x, y, cell, (strength, part) in (
        (far + 0.25 * across, rung + 0.25 * along, (spacing, 2.3 * spacing), _LADDER),
        (a + 0.2 * along, b + 0.2 * across, (spacing / 3, spacing / 3), _AREOLES),
    ):
        seeds = 0.5 + generator.uniform(-0.36, 0.36, (64, 64, 2))
        powers = generator.uniform(0.35, 1.0, (64, 64))
        sigma = max(part * leaf.length_mm / _FWHM, _SHARPEST * texel)
        lines = net(x.astype(np.float32), y.astype(np.float32), seeds, powers, cell, sigma)
        layers.append(np.float32(strength) * lines)
    return layers[0], layers[1]


def _beside_veins(leaf: LeafForm, a: Image, b: Image, wander: Image) -> tuple[Image, Image, Image]:
    """Return positions along and across the nearest main vein, and a number identifying the side of the vein."""
    below = np.where(b < 0, np.float32(1), np.float32(0))
    if not leaf.lobe_sides:
        return a, np.abs(b), below
    turns = np.array([side.azimuth_rad for side in leaf.lobe_sides if side.hand > 0][::-1], dtype=np.float32)
    turn = np.arctan2(np.abs(b) + np.float32(0.3) * wander, a)
    lobe = np.searchsorted((turns[1:] + turns[:-1]) / 2, turn)
    c, s = np.cos(turns)[lobe], np.sin(turns)[lobe]
    ahead, off = c * a + s * np.abs(b), c * np.abs(b) - s * a
    number = 2 * lobe + np.where(off < 0, np.float32(1), np.float32(0)) + 2 * len(turns) * below
    return ahead, np.abs(off), number.astype(np.float32)


def _warp(spacing: float, canvas: _Canvas, generator: np.random.Generator) -> Image:
    """Return smooth noise of the order of a spacing, for an irregular network."""
    wavelengths = (4 * spacing, 14 * spacing)
    if wavelengths[1] * canvas.texels_per_mm < 1:
        # Waves within a texel have a mean of zero.
        return np.zeros(canvas.shape, dtype=np.float32)
    noise = make_band_limited_noise(wavelengths, canvas.size_mm, generator, peak=3.0)
    return np.float32(spacing) * _interpolated(noise.coefficients, noise.period, canvas)


def _mottling(entry: LeafAppearance, canvas: _Canvas, generator: np.random.Generator) -> Image:
    noise = make_band_limited_noise(entry.mottling_wavelength_mm, canvas.size_mm, generator, exponent=-2.5, peak=_PEAK)
    return _interpolated(noise.coefficients, noise.period, canvas)


def _interpolated(coefficients: Image, period: tuple[float, float], canvas: _Canvas) -> Image:
    from scenetruth.scene.texture.texture_kernels import spline_lookup

    a, b = canvas.places()
    uv = np.column_stack([a.ravel().astype(np.float64) / period[0], b.ravel().astype(np.float64) / period[1]])
    values: Image = spline_lookup(coefficients, uv).reshape(canvas.shape)
    return values


def _speckle(entry: LeafAppearance, canvas: _Canvas, generator: np.random.Generator) -> Image:
    """Return dots at the points of a Poisson process."""
    from scenetruth.scene.leaf.leaf_kernels import draw_dots

    width, height = canvas.size_mm
    count = generator.poisson(entry.speckle_density_per_mm2 * width * height)
    places = generator.uniform(0, 1, (count, 2)) * canvas.shape[::-1] - 0.5
    raster = np.zeros(canvas.shape, dtype=np.float32)
    sigma = max(entry.speckle_size_mm * canvas.texels_per_mm / _FWHM, _DOT)
    draw_dots(raster, places, sigma, generator.uniform(0.3, 1.0, count))
    return raster


def _spline(values: Image) -> Image:
    """Return the coefficients of the interpolating periodic cubic B-spline."""
    from scipy.ndimage import spline_filter

    coefficients: Image = spline_filter(values, 3, output=np.float32, mode="grid-wrap")
    return coefficients


class LeafTexture(LeafAppearance):
    """Two-sided leaf texture: four orders of veins, mottling, and hairs."""

    kind: Literal["leaf"]
    """``leaf``."""

    def paint(self, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
        """Create the texture, see `TextureModel`."""
        return Painted(*paint_leaf(self, mesh, generator))

    def raster_shape(self, mesh: TriangleMesh, folder: Path) -> tuple[int, int]:
        """Return the raster size, see `TextureModel`."""
        return compute_painting_shape(self, mesh)

    def cache_key(self, mesh: TriangleMesh, generator: np.random.Generator) -> str:
        """Return the cache key of the raster, see `TextureModel`."""
        return compute_painting_key(self, mesh, generator)

    @property
    def shortest_and_longest_mm(self) -> tuple[float, float]:
        """Shortest and longest wavelength on the surface in mm."""
        return self.mottling_wavelength_mm
