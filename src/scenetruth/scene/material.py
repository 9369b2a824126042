"""Materials of surfaces: gloss of a dielectric coat or of metal over the texture, and light that passes a sheet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from scenetruth.validated_model import FrozenModel, NonNegative, Preset, preset

__all__ = ["MATERIALS", "Material", "MaterialName", "Optics", "pack_materials"]

Roughness = Annotated[float, Field(gt=0, le=1)]

_COMAR = (
    "Comar et al. (2014), ACT: a leaf BRDF model taking into account the azimuthal anisotropy of monocotyledonous leaf "
    "surface, Remote Sens. Environ. 143, 112, abstract"
)
_SLOPES = f"roughness of Cook and Torrance, used as that of GGX: {_COMAR}"
_TYPICAL = "typical value, no source available"
_VISIBLE = "no light passes in the blue and red; about a third in the near infrared"

MaterialName = Literal["sorghum_leaf", "wheat_leaf", "leaf", "matt_paint", "paper", "printed_foil", "anodised_aluminium", "soil"]  # noqa: E501
MATERIALS: Mapping[str, Preset] = MappingProxyType(
    {
        "sorghum_leaf": preset(
            "leaf of sorghum (Sorghum halepense), with its veins along x",
            refractive_index=(1.32, _COMAR),
            roughness=(0.56, _SLOPES),
            roughness_along=(0.27, _SLOPES),
        ),
        "wheat_leaf": preset(
            "leaf of wheat (Triticum durum), with its veins along x",
            refractive_index=(1.32, _COMAR),
            roughness=(0.46, _SLOPES),
            roughness_along=(0.18, _SLOPES),
        ),
        "leaf": preset(
            "leaf of a plant with a net of veins",
            refractive_index=(1.4, _TYPICAL),
            roughness=(0.4, _TYPICAL),
        ),
        "matt_paint": preset("matt paint", refractive_index=(1.5, _TYPICAL), roughness=(0.8, _TYPICAL)),
        "paper": preset("uncoated paper", refractive_index=(1.5, _TYPICAL), roughness=(0.9, _TYPICAL)),
        "printed_foil": preset("printed vinyl foil", refractive_index=(1.5, _TYPICAL), roughness=(0.15, _TYPICAL)),
        "anodised_aluminium": preset(
            "anodised aluminium",
            refractive_index=(1.0, "the metal reflects"),
            metallic=(1.0, "metal"),
            roughness=(0.3, _TYPICAL),
        ),
        "soil": preset("soil, without gloss", refractive_index=(1.0, _TYPICAL)),
    }
)


class Material(FrozenModel):
    """Reflection and transmission of a surface, beside its texture.

    Light that enters the surface through its smooth or rough boundary is scattered with the reflectance of the texture
    (Lambert). The boundary reflects by microfacets of the GGX distribution with the Fresnel reflectance of the
    refractive index; what it reflects does not enter. Metal reflects by its microfacets only, with the reflectance of
    the texture at normal incidence. No surface reflects more light than it receives. Without any of the fields, the
    surface is matt: it has the radiance of the texture times its irradiance.
    """

    preset: MaterialName | None = None
    """Material whose values are used for all fields that are not given."""
    refractive_index: Annotated[float, Field(ge=1, le=4)] = 1.0
    """Refractive index of the boundary; 1 for none, about 1.4 for leaves, 1.5 for varnish."""
    roughness: Roughness = 0.5
    """Roughness of the boundary (α of GGX: slope of the microfacets); small values give sharp highlights."""
    roughness_along: Roughness | None = None
    """Roughness along the x direction of the mesh, such as that of veins; null: equal in all directions."""
    metallic: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Fraction of the surface that is metal."""
    transmittance: NonNegative = 0.0
    """Light transmitted by a sheet, relative to the texture: a back light of irradiance 1 gives this value times that
    of the texture. Sheets scatter transmitted light in all directions.
    """

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        name = given.get("preset") if isinstance(given, dict) else None
        return {**MATERIALS[name].values, **given} if isinstance(name, str) and name in MATERIALS else given

    @property
    def matt(self) -> bool:
        """Whether the surface has no gloss and transmits no light."""
        return self.refractive_index == 1.0 and self.metallic == 0.0 and self.transmittance == 0.0


class Optics(NamedTuple):
    """Materials as arrays for `render.reflectance_kernels`."""

    values: NDArray[np.float64]
    """For each material: refractive index, roughness along and across, metallic fraction, transmittance, mean albedo of
    the boundary, mean albedo of mirrors, and the share of light reflected by further microfacets: of the boundary, and
    of black metal. Shape (k, 9).
    """
    tables: NDArray[np.float64]
    """Directional albedo of the boundary, of mirrors, and the part of mirrors that is weighted by (1 - cos)^5, at the
    nodes of `albedo_tables`; shape (k, 3, COSINES, AZIMUTHS).
    """


def pack_materials(materials: Sequence[Material]) -> Optics:
    """Return the parameters and tables of materials, with one row each."""
    rows = [_pack(item.refractive_index, *_roughness(item), item.metallic, item.transmittance) for item in materials]
    return Optics(np.array([row for row, _ in rows]), np.array([table for _, table in rows]))


def _roughness(material: Material) -> tuple[float, float]:
    """Return the roughness along and across."""
    across = material.roughness
    return (across if material.roughness_along is None else material.roughness_along), across


@lru_cache(maxsize=64)
def _pack(
    index: float, along: float, across: float, metallic: float, transmittance: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the row and the tables of one material."""
    from scenetruth.render.reflectance_kernels import AZIMUTHS, COSINES, albedo_tables

    values = np.array([index, along, across, metallic, transmittance, 0.0, 0.0, 0.0, 0.0])
    tables = np.zeros((3, COSINES, AZIMUTHS))
    if index == 1.0 and metallic == 0.0:
        return values, tables
    single, mirror, grazing = (albedo_tables(kind, along, across) for kind in (index, 0.0, -1.0))
    mirror_mean = _mean(mirror)
    # Mean Fresnel reflectance of the facets, for light reflected again and again.
    cosines = (np.arange(2000) + 0.5) / 2000
    means = [2 * float(np.mean(reflectance * cosines)) for reflectance in (_fresnel(cosines, index), (1 - cosines) ** 5)]
    further = [mean**2 * mirror_mean / (1 - mean * (1 - mirror_mean)) for mean in means]
    boundary = single + (1 - mirror) * further[0]
    values[5:] = _mean(boundary), mirror_mean, *further
    return values, np.stack([boundary, mirror, grazing])


def _fresnel(cosines: NDArray[np.float64], index: float) -> NDArray[np.float64]:
    from scenetruth.render.reflectance_kernels import fresnel

    return np.array([fresnel(float(cosine), index) for cosine in cosines])


def _mean(table: NDArray[np.float64]) -> float:
    """Return the mean of a directional albedo over all directions, by cosine, as the kernels interpolate it."""
    # Between nodes of s, the root of the cosine: the integral of 4 s³ E(s); azimuths by the trapezoidal rule.
    edges = np.linspace(0, 1, len(table))
    low, high = edges[:-1], edges[1:]
    whole, first = high**4 - low**4, 4 * (high**5 - low**5) / 5
    weights = np.zeros(len(table))
    weights[:-1] += (high * whole - first) / (high - low)
    weights[1:] += (first - low * whole) / (high - low)
    azimuths = np.ones(table.shape[1])
    azimuths[[0, -1]] = 0.5
    return float(weights @ table @ azimuths / azimuths.sum())
