"""Materials of surfaces: gloss of a dielectric coat or of metal over the texture, and light that passes a sheet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from scenetruth.bands import BandFraction, BandNonNegative
from scenetruth.validated_model import FrozenModel, Preset, preset

__all__ = ["MATERIALS", "MATT", "Material", "MaterialName", "MaterialOwner"]

Roughness = Annotated[float, Field(gt=0, le=1)]

_COMAR = (
    "Comar et al. (2014), ACT: a leaf BRDF model taking into account the azimuthal anisotropy of monocotyledonous leaf "
    "surface, Remote Sens. Environ. 143, 112, abstract"
)
_SLOPES = f"roughness of Cook and Torrance, used as that of GGX: {_COMAR}"
_TYPICAL = "typical value, no source available"

MaterialName = Literal[
    "sorghum_leaf", "wheat_leaf", "leaf", "matt_paint", "paper", "printed_foil", "anodised_aluminium", "soil"
]
"""Names of the presets."""
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
    """Reflection and transmission of a textured surface.

    Light that enters the surface through its smooth or rough boundary is scattered with the reflectance of the texture
    (Lambert). The boundary reflects by microfacets of the GGX distribution with the Fresnel reflectance of the
    refractive index; what it reflects does not enter. Metal reflects by its microfacets only, with the reflectance of
    the texture at normal incidence. No surface reflects more light than it receives. Without any of the fields, the
    surface is matt: it has the radiance of the texture times its irradiance.
    """

    from_file: bool = False
    """Whether the material is that of the mesh file (glTF), which may differ between its faces; without other fields.
    ``texture: {kind: embedded}`` shows the colours of the file.
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
    reflectance: BandFraction = 1.0
    """Diffuse reflectance, relative to the texture, for all bands or for each."""
    transmittance: BandNonNegative = 0.0
    """Light transmitted by a sheet, relative to the texture, for all bands or for each: a back light of irradiance 1
    gives this value times that of the texture. Sheets scatter transmitted light in all directions.
    """

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, given: Any) -> Any:
        name = given.get("preset") if isinstance(given, dict) else None
        return {**MATERIALS[name].values, **given} if isinstance(name, str) and name in MATERIALS else given

    @model_validator(mode="after")
    def _from_file_alone(self) -> Self:
        given = sorted(self.model_fields_set - {"from_file"})
        if self.from_file and given and self.model_copy(update={"from_file": False}) != type(self)():
            msg = f"from_file takes the material of the mesh file; remove {', '.join(given)}"
            raise ValueError(msg)
        return self

    @property
    def least_roughness(self) -> float:
        """Least roughness along any direction; infinite without gloss."""
        if self.refractive_index == 1.0 and self.metallic == 0.0:
            return math.inf
        return self.roughness if self.roughness_along is None else min(self.roughness, self.roughness_along)

    @property
    def matt(self) -> bool:
        """Whether the surface has no gloss and transmits no light."""
        plain = self.refractive_index == 1.0 and self.metallic == 0.0 and self.transmittance == 0.0
        return plain and self.reflectance == 1.0 and not self.from_file

    @property
    def glossy(self) -> bool:
        """Whether the surface shows highlights, or may show them because the mesh file defines its material."""
        return self.refractive_index > 1.0 or self.metallic > 0.0 or self.from_file


MATT = Material()
"""Surface without gloss and transmission."""


class MaterialOwner(FrozenModel):
    """Base class of models with fields ``material`` and ``tint``, which do not appear in their values by default.

    Scenes without gloss and colour keep their hash.
    """

    @model_serializer(mode="wrap")
    def _write(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        plain: dict[str, Any] = write(self)
        if plain.get("material") == MATT.model_dump(mode="json"):
            del plain["material"]
        if plain.get("tint") == 1.0:
            del plain["tint"]
        return plain
