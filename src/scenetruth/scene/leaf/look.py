"""What a scene file may say of what is seen on a leaf."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from scenetruth.model import Positive
from scenetruth.scene.texture import TextureModel

__all__ = ["LeafLook"]

_MOTTLING_PEAK = 4.1  # standard deviations that mottling may reach


class LeafLook(TextureModel):
    """What is seen on a leaf: veins of four orders, mottling between them, and hairs; two-sided."""

    channel: Literal["green", "near_infrared"] = "green"
    """Sets the defaults: in green light the blade is dark and its veins bright; in the near infrared it is bright and
    its veins are a little darker."""
    mean: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Mean radiance of the upper side between the veins; None: 0.26 green, 0.62 near infrared."""
    vein_contrast: Annotated[float, Field(ge=-0.9, le=2)] | None = None
    """Radiance of the midrib relative to its surroundings, less 1; None: 0.85 green, -0.28 near infrared."""
    mottling_wavelength_mm: tuple[Positive, Positive] = (0.8, 5.0)
    """Shortest and longest wavelength of the mottling in mm."""
    mottling_contrast: Annotated[float, Field(ge=0, le=1 / 3)] | None = None
    """Standard deviation of the mottling, divided by the mean; None: 0.08 green, 0.05 near infrared."""
    speckle_density_per_mm2: Annotated[float, Field(ge=0, le=50)] = 1.0
    """Hairs (trichomes) per mm²: bright dots at random places."""
    speckle_size_mm: Positive = 0.2
    """Full width of a dot at half its height in mm."""
    speckle_contrast: Annotated[float, Field(ge=0, le=2)] | None = None
    """Radiance of a dot relative to its surroundings, less 1; None: 0.35 green, 0.15 near infrared."""
    secondary_veins: Annotated[int, Field(ge=1, le=40)] = 9
    """Side veins on each side of the midrib."""
    secondary_angle_deg: Annotated[float, Field(ge=20, le=90)] = 55.0
    """Angle at which they leave the midrib; they curve to the tip as they come near the margin."""
    tertiary_spacing_mm: Positive | None = None
    """Mean distance of the veins that join side veins; None: 0.035 of the leaf's length. The finest net has a third
    of it."""
    texels_per_mm: Positive | None = None
    """Points of the raster per mm; None: what dots and mottling need, or less than
    that if it would be more than 4 million points."""
    underside_lightness: Annotated[float, Field(gt=0, le=3)] | None = None
    """Radiance of the underside relative to the upper side; None: 1.3 green, 1.05 near infrared."""
    underside_relief: Annotated[float, Field(ge=0, le=3)] = 1.25
    """Contrast of the veins on the underside relative to the upper side."""

    @property
    def settings(self) -> dict[str, float]:
        """Values of the fields that depend on the channel."""
        green = self.channel == "green"
        defaults = {
            "mean": 0.26 if green else 0.62,
            "vein_contrast": 0.85 if green else -0.28,
            "mottling_contrast": 0.08 if green else 0.05,
            "speckle_contrast": 0.35 if green else 0.15,
            "underside_lightness": 1.3 if green else 1.05,
        }
        given = {name: getattr(self, name) for name in defaults}
        return {name: default if given[name] is None else given[name] for name, default in defaults.items()}

    @field_validator("mottling_wavelength_mm")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            msg = "must be (shortest, longest) with shortest < longest"
            raise ValueError(msg)
        return value

    @model_validator(mode="after")
    def _displayable(self) -> LeafLook:
        values = self.settings
        mottling = _MOTTLING_PEAK * values["mottling_contrast"]
        for lightness, relief in ((1.0, 1.0), (values["underside_lightness"], self.underside_relief)):
            veins, mean = values["vein_contrast"] * relief, values["mean"] * lightness
            least = mean * (1 + min(veins, 0) - mottling)
            most = mean * (1 + max(veins, 0) + mottling + values["speckle_contrast"])
            if least < 0 or most > 1:
                msg = (
                    f"veins, mottling and speckle together may reach radiances from {least:.3g} to {most:.3g}; lower "
                    "mean or contrasts to stay within [0, 1]"
                )
                raise ValueError(msg)
        return self
