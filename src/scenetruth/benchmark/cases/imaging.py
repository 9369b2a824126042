"""Cases that vary the images and their acquisition: noise, texture, illumination, stage, lens, cameras, frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from scenetruth.benchmark.cases.case import Case
from scenetruth.benchmark.cases.reference_scene import build_reference_scene, build_wall


class BlurCase(Case):
    """The same sheet, less and less sharp."""

    kind = "blur"
    title = "Defocus"
    question = "How sharp must images be?"
    varied = "standard deviation of the point spread, px"
    core = (1.0,)
    full = (0.5, 1.0, 2.0, 3.0, 4.0)
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet behind such a lens."""
        return build_reference_scene({"optics.psf": {"kind": "gaussian", "sigma_px": value}})


class IlluminationChangeCase(Case):
    """The same sheet in light that grows."""

    kind = "brightness"
    title = "Change of brightness"
    question = "What does light that changes cost?"
    varied = "change of brightness per frame, %"
    core = (1.0, 10.0)
    full = (0.0, 0.3, 1.0, 3.0, 10.0)
    headline = ("velocity_z", "rmse")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet in such light."""
        return build_reference_scene({"lighting.drift_per_frame": value / 100})


class TextureContrastCase(Case):
    """A sheet whose texture fades."""

    kind = "contrast"
    title = "Contrast"
    question = "How faint may a texture be, and is that known?"
    varied = "rms contrast of the texture"
    core = (0.03, 0.2)
    full = (0.003, 0.006, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3)
    logarithmic = True
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet with this contrast."""
        return build_reference_scene({"objects.0.texture.rms_contrast": value})


class DisparityRangeCase(Case):
    """A sheet seen from positions farther and farther apart."""

    kind = "disparity"
    title = "Range of disparity"
    question = "Over which disparities does it find depth?"
    varied = "disparity, px per step"
    core = (1.3, 20.3)
    full = (0.6, 1.3, 2.6, 5.3, 10.3, 20.3, 40.3)
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return three positions so far apart."""
        wide = build_wall(size_mm=(240 + 2 * value, 190))
        return build_reference_scene({"objects": [wide], "stage.positions": 3}, baseline_mm=value)


class FlowRangeCase(Case):
    """A sheet that moves faster and faster."""

    kind = "motion"
    title = "Range of motion"
    question = "Over which motions in the image does it find them?"
    varied = "flow, px per frame"
    core = (0.1, 1.3, 6.3)
    full = (0.01, 0.03, 0.1, 0.3, 1.3, 3.3, 6.3, 12.3)
    headline = ("flow_x", "rmse")
    logarithmic = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, moving along X and a little towards the camera."""
        fast = build_wall(velocity=(value, 0.0, -0.2 * value), size_mm=(240 + 4 * value, 200))
        return build_reference_scene({"objects": [fast], "frames.count": 3})


class NoiseFloorCase(Case):
    """A sheet at rest, with more and more noise in its images."""

    kind = "noise"
    title = "Noise floor"
    question = "How much of the noise of the images reaches the estimate, and how close is that to what is possible?"
    varied = "noise of the images, standard deviation, of full scale"
    core = (0.005, 0.02)
    full = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
    logarithmic = True
    seeds: ClassVar[Mapping[str, int]] = {"core": 3, "full": 8}
    bounded = True
    quantities = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")
    headline = ("disparity", "noise_std")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet at rest."""
        return build_reference_scene({"objects.0.motion": []})

    def noise_std(self, value: float) -> float:
        """Return the noise itself."""
        return value


class DisparitySubpixelBiasCase(Case):
    """A sheet whose disparity has another fraction of a pixel, without noise."""

    kind = "phase_of_disparity"
    title = "Phase of disparity"
    question = "Does the error depend on where between two pixels a point is seen by the next camera?"
    varied = "disparity, px per step"
    core = (4.0, 4.25, 4.75)
    full = tuple(4 + k / 16 for k in range(17))
    headline = ("disparity", "bias")
    quantities = ("depth", "disparity")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, at rest: more frames would show the same."""
        return build_reference_scene({"objects.0.motion": [], "frames.count": 3}, baseline_mm=value)

    def noise_std(self, value: float) -> float:
        """Return none: biases are small."""
        return 0.0


class FlowSubpixelBiasCase(Case):
    """A sheet that moves across by another fraction of a pixel per frame, without noise."""

    kind = "phase_of_flow"
    title = "Phase of motion"
    question = "Does the error of motion depend on the fraction of a pixel?"
    varied = "flow, px per frame"
    core = (0.0, 0.25, 0.75)
    full = tuple(k / 16 for k in range(17))
    headline = ("flow_x", "bias")
    quantities = ("velocity_x", "flow_x")

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet, moving along X."""
        return build_reference_scene({"objects.0.motion.0.velocity_mm_per_frame": [value, 0.0, 0.0]})

    def noise_std(self, value: float) -> float:
        """Return none: biases are small."""
        return 0.0


class StagePositionErrorCase(Case):
    """Positions that are missed by chance, at every visit anew."""

    kind = "stage_error"
    title = "Error of the stage"
    question = "What do missed positions cost?"
    varied = "repeatability of the stage, px in the image"
    core = (0.1,)
    full = (0.0, 0.03, 0.1, 0.3)

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet seen from such a stage; 1 px is 1 mm here."""
        return build_reference_scene({"stage.errors.repeatability_um": 1000 * value})


class TextureWavelengthCase(Case):
    """A sheet with waves of nearly one length, in all directions."""

    kind = "wavelength"
    title = "Wavelength"
    question = "Which texture suits it?"
    varied = "wavelength of the texture, px"
    core = (3.0, 24.0)
    full = (2.2, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 40.0)
    logarithmic = True
    bounded = True

    def scene(self, value: float) -> Mapping[str, Any]:
        """Return the sheet with waves of this length, to a fifth."""
        return build_reference_scene({"objects.0.texture.wavelength_mm": [value / 1.1, value * 1.1]})
