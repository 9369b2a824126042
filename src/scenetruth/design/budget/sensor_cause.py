"""What causes in the sensor have in common: effects of its chain that are taken out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np

from scenetruth.camera import LinearImage, chain_of
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Cause
from scenetruth.design.budget.sight import Change, Disturbance, Sight
from scenetruth.design.budget.switches import scene_with
from scenetruth.randomness import generator_for
from scenetruth.scene import Scene

__all__ = ["SensorCause"]


class SensorCause(Cause):
    """A cause in the sensor: some effects of its chain, or some of their values."""

    group = "images"
    effects: ClassVar[tuple[str, ...]] = ()
    """Kinds of the effects that are left out where the cause is off."""
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Values of other effects where it is off, by their kinds."""

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether the sensor has such an effect."""
        sensor = chain_of(scene.sensor).model_dump(mode="json")
        return any(one["kind"] in self.effects for one in sensor["effects"]) or self.unlike(sensor)

    def unlike(self, sensor: Any) -> bool:
        """Return whether a value of another effect makes the cause."""
        return False

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Take its effects out of the chain; see `Cause`."""
        if not isinstance(plain["sensor"], dict):
            return
        left = [one for one in plain["sensor"]["effects"] if one["kind"] not in self.effects]
        plain["sensor"]["effects"] = [{**one, **self.settings.get(one["kind"], {})} for one in left]

    def disturbances(self, sight: Sight) -> Iterable[Disturbance]:
        """Give one draw of what the sensor adds to each image: over many pixels it is as good as all."""
        perfect, alone = (chain_of(scene_with(sight.scene, kinds).sensor) for kinds in ((), (self.kind,)))
        size = sight.texture.shape
        # Others than those of the images, which are drawn from the scene's own seed.
        without, with_it = (chain.open(size, partial(generator_for, 1, "budget")) for chain in (perfect, alone))

        def change(s: int, t: int) -> Change:
            image = LinearImage(sight.recording["ideal"].sel(s=s, t=t).values, 0, s, t)
            grey = np.asarray(with_it.read(image), dtype=np.float64) / alone.full_scale
            return Change(grey=sight.fetched(grey - without.read(image) / perfect.full_scale, s, t))

        yield change

    def deviation(self, scene: Scene) -> float:
        """Return the standard deviation that it gives a grey value of half of full scale, as a share of that."""
        perfect, alone = (chain_of(scene_with(scene, kinds).sensor) for kinds in ((), (self.kind,)))
        size = (64, 64)
        image = LinearImage(np.full(size, 0.5 * perfect.saturation_radiance, dtype=np.float32))
        found = [
            np.asarray(chain.open(size, partial(generator_for, 1, "budget")).read(image), dtype=np.float64)
            / chain.full_scale
            for chain in (perfect, alone)
        ]
        return float((found[1] - found[0]).std())
