"""Noise of the sensor that is new in every image."""

from __future__ import annotations

from scenetruth.camera import chain_of
from scenetruth.design.budget.calibration import Calibration
from scenetruth.design.budget.cause import Remedy
from scenetruth.design.budget.sensor_cause import SensorCause
from scenetruth.scene import Scene


class Noise(SensorCause):
    """Shot noise, noise of the readout, and the plain sensor's Gaussian noise."""

    kind = "noise"
    title = "noise of the sensor"
    effects = ("gaussian_noise", "shot_noise", "readout_noise")

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the noise of a grey value in the middle of the range."""
        if getattr(scene.sensor, "kind", "") == "gaussian":
            return f"{100 * float(getattr(scene.sensor, 'noise_std', 0.0)):g} % of full scale"
        return f"{100 * self.deviation(scene):.2g} % of full scale"

    def remedy(self, scene: Scene, calibration: Calibration) -> Remedy:
        """Return what halves it."""
        kinds = {effect.kind for effect in chain_of(scene.sensor).effects}
        if "gaussian_noise" in kinds:
            value = float(getattr(scene.sensor, "noise_std", 0.0)) / 2
            field = f"sensor.noise_std: {value:g}" if value else "half the noise"
            return Remedy(f"the mean of four images ({field})", {self.kind: 0.5})
        return Remedy("the mean of four images, or four times the light and full well", {self.kind: 0.5})
