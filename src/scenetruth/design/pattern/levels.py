"""Grey values of a rig's images, and their noise, at a level of light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scenetruth.camera import chain_of
from scenetruth.design.pattern.rig import Rig
from scenetruth.design.predict.grey import grey_of

__all__ = ["Level", "level_at", "level_of"]

# Levels between which a sensor's response is inverted.
_LEVELS = 257


@dataclass(frozen=True)
class Level:
    """A grey value, as a share of full scale.

    Parameters
    ----------
    grey
        The grey value.
    gain
        What it changes by per radiance.
    noise_std
        Standard deviation of the noise that is new in every image, rounding included; 0 of an ideal sensor.
    """

    grey: float
    gain: float
    noise_std: float


def level_at(rig: Rig, radiance: float) -> Level:
    """Return the grey value that a rig's sensor gives of a radiance."""
    found = grey_of(rig.sensor, np.array([radiance]))
    return Level(float(found.level[0]), float(found.gain[0]), float(found.noise[0]))


def level_of(rig: Rig, grey: float) -> Level:
    """Return the level of light at which a rig's sensor gives a grey value."""
    radiances = np.linspace(0.0, chain_of(rig.sensor).saturation_radiance, _LEVELS)
    return level_at(rig, float(np.interp(grey, grey_of(rig.sensor, radiances).level, radiances)))
