"""Textures: the radiance of a surface at its texture coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from scenetruth.errors import Problem, SceneError
from scenetruth.scene import spec
from scenetruth.scene.mesh import TriangleMesh
from scenetruth.scene.noise import BandLimitedNoise, band_limited_noise

__all__ = ["Painted", "SurfaceTexture", "make_texture", "noise_limit"]

UV = NDArray[np.float64]
Floats = NDArray[np.float64]

# A smooth ramp of 256 texels carries any radiance in [0, 1] as a texture coordinate.
_RAMP = 256
_PLAID_TEXELS = 64


class SurfaceTexture(Protocol):
    """What is painted on a surface; coordinates (u, v) count in tiles, u to the right and v down."""

    @property
    def tiled(self) -> bool:
        """Whether the raster repeats beyond [0, 1]; otherwise its border extends."""
        ...

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        """Return the radiance at texture coordinates of shape (n, 2)."""
        ...

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        """Return the weighted mean of the radiance over the samples of footprints.

        Parameters
        ----------
        forms
            Texture coordinates (u, v) = (U / W, V / W) of n footprints, shape (n, 3, 3): one row for each of U, V and
            W, with its value in the middle and its steps per px to the right and down.
        offsets
            Where the samples are, in px from the middle, shape (m, 2).
        weights
            What each of them counts, shape (m,); they sum to 1.
        """
        ...

    @property
    def cubic(self) -> bool:
        """Whether the raster is to be read as a cubic B-spline; otherwise by bilinear interpolation."""
        ...

    def raster(self) -> NDArray[np.float32]:
        """Return one tile, shape (h, w), for other renderers: coefficients of the spline, or values to interpolate.

        Texel (i, j) stands at ((j + 1/2) / w, (i + 1/2) / h).
        """
        ...


class Painted(NamedTuple):
    """A texture, and where the corners of a mesh's faces are on it."""

    texture: SurfaceTexture
    """The texture."""
    uv: UV
    """Texture coordinates at every corner of every face, shape (m, 3, 2)."""
    uv_back: UV | None = None
    """Those of the side that faces wind clockwise on, if it shows something else; shape (m, 3, 2)."""


@dataclass(frozen=True, eq=False)
class _Noise:
    noise: BandLimitedNoise
    mean: float
    std: float
    tiled: bool = True
    cubic: bool = True

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        from scenetruth.scene.texture_kernels import spline_lookup

        values: NDArray[np.float32] = spline_lookup(self.noise.coefficients, np.ascontiguousarray(uv))
        values *= np.float32(self.std)
        values += np.float32(self.mean)
        return values

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        from scenetruth.scene.texture_kernels import spline_means

        means: NDArray[np.float32] = spline_means(self.noise.coefficients, forms, offsets, weights)
        means *= np.float32(self.std)
        means += np.float32(self.mean)
        return means

    def raster(self) -> NDArray[np.float32]:
        return np.float32(self.mean) + np.float32(self.std) * self.noise.coefficients


@dataclass(frozen=True, eq=False)
class _Image:
    values: NDArray[np.float32]
    tiled: bool
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        from scenetruth.scene.texture_kernels import linear_lookup

        values: NDArray[np.float32] = linear_lookup(self.values, np.ascontiguousarray(uv), self.tiled)
        return values

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        from scenetruth.scene.texture_kernels import linear_means

        means: NDArray[np.float32] = linear_means(self.values, forms, offsets, weights, self.tiled)
        return means

    def raster(self) -> NDArray[np.float32]:
        return self.values


@dataclass(frozen=True)
class _Uniform:
    value: float
    tiled: bool = True
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        return np.full(len(uv), self.value, dtype=np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        return np.full(len(forms), self.value, dtype=np.float32)

    def raster(self) -> NDArray[np.float32]:
        return np.full((2, 2), self.value, dtype=np.float32)


@dataclass(frozen=True)
class _Plaid:
    mean: float
    amplitude: float
    tiled: bool = True
    cubic: bool = True

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        waves = np.cos(2 * np.pi * uv[:, 0]) * np.cos(2 * np.pi * uv[:, 1])
        return (self.mean + self.amplitude * waves).astype(np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        from scenetruth.scene.texture_kernels import plaid_means

        return np.asarray(self.mean + self.amplitude * plaid_means(forms, offsets, weights), dtype=np.float32)

    def raster(self) -> NDArray[np.float32]:
        centres = (np.arange(_PLAID_TEXELS) + 0.5) / _PLAID_TEXELS
        wave = np.cos(2 * np.pi * centres)
        # A cubic B-spline takes a sampled wave of angular frequency ω per texel times (2 + cos ω) / 3.
        response = (2 + np.cos(2 * np.pi / _PLAID_TEXELS)) / 3
        coefficients = self.mean + self.amplitude / response**2 * np.outer(wave, wave)
        return np.asarray(coefficients, dtype=np.float32)


@dataclass(frozen=True)
class _Ramp:
    """Radiance carried by u itself, for colours that stand at the vertices."""

    tiled: bool = False
    cubic: bool = False

    def radiance(self, uv: UV) -> NDArray[np.float32]:
        return ((uv[:, 0] * _RAMP - 0.5) / (_RAMP - 1)).astype(np.float32)

    def mean_radiance(self, forms: Floats, offsets: Floats, weights: Floats) -> NDArray[np.float32]:
        lattice = np.column_stack([np.ones(len(offsets)), offsets])
        u = np.einsum("nm,m->n", (forms[:, 0] @ lattice.T) / (forms[:, 2] @ lattice.T), weights)
        return self.radiance(u[:, None])

    def raster(self) -> NDArray[np.float32]:
        return np.tile(np.linspace(0, 1, _RAMP, dtype=np.float32), (2, 1))


def make_texture(entry: spec.Texture, mesh: TriangleMesh, folder: Path, generator: np.random.Generator) -> Painted:
    """Make a texture and the texture coordinates of a mesh.

    Parameters
    ----------
    entry
        The texture of the scene.
    mesh
        The mesh that wears it.
    folder
        Where relative paths count from.
    generator
        Source of noise.

    Returns
    -------
    Painted
        The texture with its coordinates.

    Raises
    ------
    SceneError
        If the texture does not fit the mesh, or its file is missing or unreadable.
    """
    if isinstance(entry, spec.NoiseTexture):
        low = mesh.chart_mm.min(axis=(0, 1))
        width, height = np.ptp(mesh.chart_mm, axis=(0, 1))
        noise = band_limited_noise(
            entry.wavelength_mm,
            (float(width), float(height)),
            generator,
            exponent=entry.spectrum_exponent,
            peak=noise_limit(entry),
        )
        texture = _Noise(noise, entry.mean, entry.mean * entry.rms_contrast)
        return Painted(texture, (mesh.chart_mm - low) / noise.period)
    if isinstance(entry, spec.PlaidTexture):
        phases = np.asarray(entry.phase_deg) / 360.0
        return Painted(_Plaid(entry.mean, entry.amplitude), mesh.chart_mm / entry.wavelength_mm + phases)
    if isinstance(entry, spec.UniformTexture):
        return Painted(_Uniform(entry.radiance), np.zeros_like(mesh.chart_mm))
    if isinstance(entry, spec.LeafTexture):
        from scenetruth.scene.leaf_texture import paint_leaf

        return Painted(*paint_leaf(entry, mesh, generator))
    if isinstance(entry, spec.ImageTexture):
        if mesh.uv is None:
            remedy = "the mesh has no UV coordinates to lay an image on; use a noise, plaid or uniform texture"
            raise SceneError([Problem("kind", remedy, entry.kind)])
        values = _luminance(_read_image(folder / entry.file), entry.encoding)
        return Painted(_Image(values, mesh.tiled), mesh.uv, mesh.uv_back)
    return Painted(*_own_texture(entry, mesh))


def noise_limit(entry: spec.NoiseTexture) -> float:
    """Return by how many standard deviations a noise texture may leave its mean without leaving [0, 1]."""
    std = entry.mean * entry.rms_contrast
    return 4.0 if std == 0 else min(4.0, min(entry.mean, 1 - entry.mean) / std)


def _own_texture(entry: spec.OwnTexture, mesh: TriangleMesh) -> tuple[SurfaceTexture, UV]:
    if mesh.image is not None and mesh.uv is not None:
        return _Image(_luminance(mesh.image, entry.encoding), mesh.tiled), mesh.uv
    if mesh.vertex_colours is not None:
        values = _luminance(mesh.vertex_colours[None], entry.encoding)[0].astype(np.float64)
        u = (values * (_RAMP - 1) + 0.5) / _RAMP
        corners = u[mesh.faces]
        return _Ramp(), np.stack([corners, np.full_like(corners, 0.5)], axis=-1)
    raise SceneError(
        [Problem("kind", "the mesh brings no texture image and no vertex colours; give it a texture", "own")]
    )


def _read_image(file: Path) -> NDArray[Any]:
    import imageio.v3 as imageio

    if not file.is_file():
        raise SceneError([Problem("file", "no such image file", str(file))])
    try:
        # From memory: imageio leaves files open that none of its plugins can read.
        return np.asarray(imageio.imread(file.read_bytes(), extension=file.suffix))
    except Exception as error:  # the readers of imageio's plugins raise whatever they like
        raise SceneError([Problem("file", f"cannot be read as an image: {error}", str(file))]) from error


def _luminance(image: NDArray[Any], encoding: str) -> NDArray[np.float32]:
    """Return the luminance (Rec. 709 primaries) of an image in [0, 1], linear in radiance."""
    values = image.astype(np.float64)
    if np.issubdtype(image.dtype, np.integer):
        values /= np.iinfo(image.dtype).max
    elif image.dtype == np.bool_:
        encoding = "linear"
    if encoding == "srgb":
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    if values.ndim == 3 and values.shape[2] >= 3:
        values = values[..., :3] @ np.array([0.2126, 0.7152, 0.0722])
    elif values.ndim == 3:
        values = values[..., 0]
    return np.clip(values, 0, 1).astype(np.float32)
