"""Cases that vary the images and their acquisition: noise, texture, illumination, stage, lens, cameras, frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.benchmark.cases.case import Case
from scenetruth.benchmark.cases.reference_scene import build_reference_scene, build_wall


class BlurCase(Case):
    """A plane with increasing image blur."""

    kind = "blur"
    title = "Defocus"
    question = "How does image blur affect the accuracy?"
    varied = "standard deviation of the point spread function, px"
    core = (1.0,)
    full = (0.5, 1.0, 2.0, 3.0, 4.0)
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane with a blurring lens."""
        return build_reference_scene({"optics.psf": {"kind": "gaussian", "sigma_px": value}})


class IlluminationChangeCase(Case):
    """A plane with increasing illumination."""

    kind = "brightness"
    title = "Illumination change"
    question = "How does a change of illumination affect the accuracy?"
    varied = "change of illumination per frame, %"
    core = (1.0, 10.0)
    full = (0.0, 0.3, 1.0, 3.0, 10.0)
    headline = ("velocity_z", "rmse")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane with changing illumination."""
        return build_reference_scene({"lighting.drift_per_frame": value / 100})


class TextureContrastCase(Case):
    """A plane with decreasing texture contrast."""

    kind = "contrast"
    title = "Contrast"
    question = "What is the minimum texture contrast, and do the stated uncertainties represent low contrast?"
    varied = "RMS contrast of the texture"
    core = (0.03, 0.2)
    full = (0.003, 0.006, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3)
    logarithmic = True
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane with this contrast."""
        return build_reference_scene({"objects.0.texture.rms_contrast": value})


class DisparityRangeCase(Case):
    """A plane with an increasing distance of the stage positions."""

    kind = "disparity"
    title = "Range of disparity"
    question = "In which range of disparity is depth estimated?"
    varied = "disparity, px per step"
    core = (1.3, 20.3)
    full = (0.6, 1.3, 2.6, 5.3, 10.3, 20.3, 40.3)
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return three positions with this disparity."""
        wide = build_wall(size_mm=(240 + 2 * value, 190))
        return build_reference_scene({"objects": [wide], "stage.positions": 3}, baseline_mm=value)


class FlowRangeCase(Case):
    """A plane with increasing velocity."""

    kind = "motion"
    title = "Flow range"
    question = "In which range of optical flow is motion estimated?"
    varied = "flow, px per frame"
    core = (0.1, 1.3, 6.3)
    full = (0.01, 0.03, 0.1, 0.3, 1.3, 3.3, 6.3, 12.3)
    headline = ("flow_x", "rmse")
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane, moving along X and slightly towards the camera."""
        fast = build_wall(velocity=(value, 0.0, -0.2 * value), size_mm=(240 + 4 * value, 200))
        return build_reference_scene({"objects": [fast], "frames.count": 3})


class NoiseFloorCase(Case):
    """A static plane with increasing image noise."""

    kind = "noise"
    title = "Noise floor"
    question = "How much of the image noise reaches the estimate, and how close is the result to the Cramér-Rao bound?"
    varied = "image noise (standard deviation), of full scale"
    core = (0.005, 0.02)
    full = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
    logarithmic = True
    seeds: ClassVar[Mapping[str, int]] = {"core": 3, "full": 8}
    bounded = True
    quantities = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")
    headline = ("disparity", "noise_std")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the static plane."""
        return build_reference_scene({"objects.0.motion": []})

    def noise_std(self, value: float) -> float:
        """Return the level."""
        return value


class DisparitySubpixelBiasCase(Case):
    """A plane with a varied fraction of a pixel of disparity, without noise."""

    kind = "phase_of_disparity"
    title = "Disparity subpixel bias"
    question = "Does the error depend on the subpixel part of the disparity?"
    varied = "disparity, px per step"
    core = (4.0, 4.25, 4.75)
    full = tuple(4 + k / 16 for k in range(17))
    headline = ("disparity", "bias")
    quantities = ("depth", "disparity")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the static plane, in three frames; more would be identical."""
        return build_reference_scene({"objects.0.motion": [], "frames.count": 3}, baseline_mm=value)

    def noise_std(self, value: float) -> float:
        """Return 0, because the biases are small."""
        return 0.0


class FlowSubpixelBiasCase(Case):
    """A plane with a varied fraction of a pixel of flow per frame, without noise."""

    kind = "phase_of_flow"
    title = "Flow subpixel bias"
    question = "Does the error depend on the subpixel part of the flow?"
    varied = "flow, px per frame"
    core = (0.0, 0.25, 0.75)
    full = tuple(k / 16 for k in range(17))
    headline = ("flow_x", "bias")
    quantities = ("velocity_x", "flow_x")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane, moving along X."""
        return build_reference_scene({"objects.0.motion.0.velocity_mm_per_frame": [value, 0.0, 0.0]})

    def noise_std(self, value: float) -> float:
        """Return 0, because the biases are small."""
        return 0.0


class StagePositionErrorCase(Case):
    """Random position errors of the stage, independent at every visit."""

    kind = "stage_error"
    title = "Stage position error"
    question = "How do position errors of the stage affect the accuracy?"
    varied = "repeatability of the stage, px in the image"
    core = (0.1,)
    full = (0.0, 0.03, 0.1, 0.3)

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane with this stage repeatability; 1 px corresponds to 1 mm."""
        return build_reference_scene({"stage.errors.repeatability_um": 1000 * value})


class TextureWavelengthCase(Case):
    """A plane with a texture of nearly one wavelength, in all directions."""

    kind = "wavelength"
    title = "Wavelength"
    question = "Which texture wavelength is optimal?"
    varied = "wavelength of the texture, px"
    core = (3.0, 24.0)
    full = (2.2, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 40.0)
    logarithmic = True
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the plane with this wavelength, ± 20 %."""
        return build_reference_scene({"objects.0.texture.wavelength_mm": [value / 1.1, value * 1.1]})
