"""Parts of a goal: what is to be known, the light there is, how long to search, and how much to simulate."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from scenetruth.design.optimise.statistics import Statistic
from scenetruth.model import FrozenModel, Name, Positive

__all__ = ["Confirm", "Light", "Search", "Wanted"]


class Wanted(FrozenModel):
    """A quantity whose errors are to be small."""

    quantity: str
    """What is to be known: a key of `scenetruth.scoring.QUANTITIES`, such as ``depth`` or ``growth_rate``."""
    region: Name = "interior"
    """Where: ``all``, ``interior``, or ``object_NAME``."""
    statistic: Statistic = "typical"
    """Of which statistic of the errors in the region: ``typical``, 1.4826 times the median of their sizes, which is the
    standard deviation where errors are normal, and which few places that are far off do not change; ``rms``, which they
    do; ``percentile_95``, below which the sizes of 95 % of them lie."""
    within: Positive | None = None
    """What of it is good enough, in mm, mm/frame or %/h; the smaller the better if not given."""


class Light(FrozenModel):
    """The light that falls on the scene, which says how many photons the pixels of a camera get.

    A white matt surface in E lux sends E / (4 N²) lux through a lens at the effective f-number N; at 555 nm, a lux is
    1 / 683 W/m².
    """

    illuminance_lux: Positive
    """On a surface whose radiance is 1 in the scene. A bright office has 500, a lit bench 10,000, sunlight 100,000."""
    wavelength_um: Annotated[float, Field(ge=0.3, le=1.2)] = 0.55
    """Wavelength of the light, for diffraction."""


class Search(FrozenModel):
    """How many predictions are made, and of which kind."""

    predictions: Annotated[int, Field(ge=16, le=1_000_000)] = 2400
    """Predictions in all, at most."""
    morris: Annotated[int, Field(ge=0, le=1000)] = 10
    """Trajectories of Morris' method; each takes one prediction more than there are free parameters. 0 for none."""
    sobol: Annotated[int, Field(ge=0, le=65536)] = 64
    """Base samples of Sobol' indices, a power of two; each takes two predictions more than there are free parameters.
    0 for none."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of the search."""


class Confirm(FrozenModel):
    """Which rigs are simulated, and how."""

    rigs: Annotated[int, Field(ge=0, le=1000)] = 3
    """How many rigs of the front; 0 to simulate nothing."""
    seeds: Annotated[int, Field(ge=1, le=1000)] = 5
    """Recordings of each, with other textures, noise and errors of the stage. Few tell little: from 3, 5 and 8 seeds,
    intervals of another recording reach 5.0, 3.0 and 2.5 standard deviations to either side."""
    most_px: Annotated[int, Field(ge=32, le=32768)] | None = 240
    """Images are cut to so many pixels along their longer side, around the middle of the first objective's region; they
    are wider by the disparity between the outermost positions, and lower in return. null for whole images."""
