"""The sensors that a scene may have, and the chain of effects that models each of them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Tag

from scenetruth.camera.sensor.chain import SensorChain
from scenetruth.camera.sensor.emva1288 import EmvaSensor
from scenetruth.camera.sensor.gaussian import GaussianSensor
from scenetruth.kinds import kind_in_lower_case

__all__ = ["AnySensor", "chain_of"]


def _in_lower_case(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else kind_in_lower_case(value)


def _sensor_kind(value: object) -> str:
    """Return the kind of a sensor; the Gaussian sensor may leave it out."""
    if isinstance(value, str):
        return "ideal"
    kind = value.get("kind", "gaussian") if isinstance(value, dict) else getattr(value, "kind", "gaussian")
    return str(kind)


AnySensor = Annotated[
    Annotated[Literal["ideal"], Tag("ideal")]
    | Annotated[GaussianSensor, Tag("gaussian")]
    | Annotated[EmvaSensor, Tag("emva1288")]
    | Annotated[SensorChain, Tag("chain")],
    Discriminator(_sensor_kind),
    BeforeValidator(_in_lower_case),
]
"""A sensor as a scene says it."""


def chain_of(sensor: Literal["ideal"] | GaussianSensor | EmvaSensor | SensorChain) -> SensorChain:
    """Return the chain of effects that models a sensor.

    Parameters
    ----------
    sensor
        The sensor, as a scene describes it.

    Returns
    -------
    SensorChain
        Its effects; the empty chain for ``"ideal"``.
    """
    if isinstance(sensor, str):
        return SensorChain()
    return sensor if isinstance(sensor, SensorChain) else sensor.chain()
