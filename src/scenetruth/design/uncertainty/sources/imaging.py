"""Sources of uncertainty in the images: sensor, lens and illumination."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, ClassVar

import numpy as np
from scipy.ndimage import laplace

from scenetruth.camera import LinearImage, build_sensor_chain
from scenetruth.camera.lens import AiryPsf, GaussianPsf
from scenetruth.design.uncertainty.observation_model import Disturbance, ImageDisturbance, Map, ObservationModel
from scenetruth.design.uncertainty.source import Calibration, Mitigation, UncertaintySource, restrict_sources
from scenetruth.number_format import format_two_digits
from scenetruth.random_streams import generator_for
from scenetruth.scene import Scene

__all__ = ["SensorSource"]


class SensorSource(UncertaintySource):
    """A source in the sensor: effects of its chain, or parameters of effects."""

    group = "images"
    on_contrast = True
    effects: ClassVar[tuple[str, ...]] = ()
    """Effects that are removed where the source is switched off."""
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Parameters of other effects where it is switched off, by effect."""

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether the sensor has such an effect."""
        sensor = build_sensor_chain(scene.sensor).model_dump(mode="json")
        return any(one["kind"] in self.effects for one in sensor["effects"]) or self.unlike(sensor)

    def unlike(self, sensor: Any) -> bool:
        """Return whether a parameter of another effect activates the source."""
        return False

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Remove the effects from the chain; see `UncertaintySource`."""
        if not isinstance(plain["sensor"], dict):
            return
        left = [one for one in plain["sensor"]["effects"] if one["kind"] not in self.effects]
        plain["sensor"]["effects"] = [{**one, **self.settings.get(one["kind"], {})} for one in left]

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield one realisation of the sensor's contribution to each image, representative over many pixels."""
        perfect, alone = (
            build_sensor_chain(restrict_sources(sight.scene, kinds).sensor) for kinds in ((), (self.kind,))
        )
        size = sight.texture.shape
        # Independent of the noise of the images, which is drawn from the seed of the scene.
        without, with_it = (chain.open(size, partial(generator_for, 1, "budget")) for chain in (perfect, alone))

        def change(s: int, t: int) -> ImageDisturbance:
            image = LinearImage(sight.recording["radiance"].sel(s=s, t=t).values, 0, s, t)
            grey = np.asarray(with_it.read(image), dtype=np.float64) / alone.full_scale
            return ImageDisturbance(grey=sight.fetched(grey - without.read(image) / perfect.full_scale, s, t))

        yield change

    def deviation(self, scene: Scene) -> float:
        """Return the standard deviation at half of full scale, relative to full scale."""
        perfect, alone = (build_sensor_chain(restrict_sources(scene, kinds).sensor) for kinds in ((), (self.kind,)))
        size = (64, 64)
        image = LinearImage(np.full(size, 0.5 * perfect.saturation_radiance, dtype=np.float32))
        found = [
            np.asarray(chain.open(size, partial(generator_for, 1, "budget")).read(image), dtype=np.float64)
            / chain.full_scale
            for chain in (perfect, alone)
        ]
        return float((found[1] - found[0]).std())


def compute_blur_change(sight: ObservationModel, variance: Callable[[Map, Map], Map]) -> Disturbance:
    """Return the effect of a change of blur over time: δ/2 ∇²T for an increase δ of the variance of a Gaussian blur.

    ``variance``: Function of the relative increase in scale and the depth in mm of points that returns δ in px².
    """
    curvature = 0.5 * laplace(sight.texture)

    def change(s: int, t: int) -> ImageDisturbance:
        place = sight.place(s, t)
        depth = sight.intrinsics.focal_length_px * sight.intrinsics.baseline_mm / (sight.points.d * place.scale)
        return ImageDisturbance(grey=np.asarray(variance(place.scale - 1, depth) * curvature))

    return change


class IlluminationDriftSource(UncertaintySource):
    """Change of brightness of the whole image between frames."""

    kind = "brightness"
    title = "illumination drift"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"lighting.drift_per_frame": 0.0, "lighting.flicker": None}
    takes_contrast = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return drift and flicker."""
        light = scene.lighting
        values = [f"{100 * light.drift_per_frame:g} % per frame"] if light.drift_per_frame else []
        return ", ".join(values + ([f"± {100 * light.flicker.amplitude:g} %"] if light.flicker else []))

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the change of all grey values."""
        light = sight.scene.lighting

        def change(s: int, t: int) -> ImageDisturbance:
            return ImageDisturbance(grey=(light.brightness(t) / light.brightness(0) - 1) * sight.texture)

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return stabilised light."""
        drift = scene.lighting.drift_per_frame / 10
        words = f"light with a tenth of this drift (lighting.drift_per_frame: {drift:g})"
        return Mitigation(f"{words}, or normalisation of images by a grey reference in the image", {self.kind: 0.1})


class DefocusBlurSource(UncertaintySource):
    """Defocus discs that change with the distance of the object; a disc of diameter D has the variance D²/16."""

    kind = "defocus"
    title = "defocus"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"optics.defocus": None}
    takes_contrast = True
    coarse = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return aperture and focus distance."""
        defocus = scene.optics.defocus
        return "" if defocus is None else f"{defocus.aperture_mm:g} mm, focus at {defocus.focus_distance_mm:g} mm"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the change of blur with the distance of the object."""
        defocus = sight.scene.optics.defocus
        if defocus is None:
            return
        focal = sight.intrinsics.focal_length_px
        now = defocus.blur_diameter_px(np.nan_to_num(sight.depth, nan=defocus.focus_distance_mm), focal) ** 2 / 16

        def grown(closer: Map, depth: Map) -> Map:
            return defocus.blur_diameter_px(depth, focal) ** 2 / 16 - now * (1 + 2 * closer)

        yield compute_blur_change(sight, grown)

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return half the aperture."""
        defocus = scene.optics.defocus
        if defocus is None:
            return None
        return Mitigation(
            f"half the aperture (optics.defocus.aperture_mm: {defocus.aperture_mm / 2:g})", {self.kind: 0.25}
        )


class FixedPatternNoiseSource(SensorSource):
    """Non-uniform sensitivities and offsets of pixels, and hot pixels."""

    kind = "fixed_pattern"
    title = "fixed-pattern noise"
    effects = ("photo_response_nonuniformity", "dark_signal_nonuniformity")
    # Hot pixels are part of the dark current, which has no other pattern.
    settings: ClassVar[Mapping[str, Mapping[str, Any]]] = {"dark_current": {"hot_pixel_share": 0.0}}

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the standard deviation of a grey value."""
        return f"{format_two_digits(100 * self.deviation(scene))} % of full scale"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a flat-field correction."""
        return Mitigation(
            "a correction of the images by a dark and a bright image (`two_point_correction`)", {self.kind: 0.1}
        )

    def unlike(self, sensor: Any) -> bool:
        """Return whether the sensor has hot pixels."""
        return any(one.get("hot_pixel_share") for one in sensor["effects"])


class PointSpreadSource(UncertaintySource):
    """A point-spread function of constant size in px, at any distance of the object.

    An approaching object appears larger, and relatively less blurred. With blur variance σ², an image magnified by ε
    shows the texture changed by - ε σ² ∇²T.
    """

    kind = "lens_blur"
    title = "lens blur"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"optics.psf": None}
    takes_contrast = True
    coarse = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the width of the point-spread function."""
        psf = scene.optics.psf
        return "" if psf is None else f"{format_two_digits(np.sqrt(_variance(psf)))} px"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the change of contrast with the distance of the object."""
        psf = sight.scene.optics.psf
        if psf is not None:
            variance = _variance(psf)
            yield compute_blur_change(sight, lambda closer, depth: -2 * closer * variance)

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a wider aperture, or another lens."""
        words = "a wider aperture (optics.psf.f_number)" if isinstance(scene.optics.psf, AiryPsf) else "a better lens"
        return Mitigation(f"{words}, with half the blur", {self.kind: 0.25})


def _variance(psf: GaussianPsf | AiryPsf) -> float:
    # The variance of an Airy pattern diverges; use that of the Gaussian fitted to its core.
    return float(psf.finest_px**2)


class MotionBlurSource(UncertaintySource):
    """Motion during the exposure; steady motion reduces contrast, but does not displace images."""

    kind = "motion_blur"
    title = "motion during the exposure"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"shutter.exposure_time_s": 0.0, "shutter.stage_speed_mm_per_s": 0.0}
    takes_contrast = True
    coarse = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether motion during the exposure is possible."""
        return scene.shutter.exposure_time_s > 0

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the exposure time."""
        return f"{scene.shutter.exposure_time_s:g} s"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return half the exposure time."""
        half = scene.shutter.exposure_time_s / 2
        return Mitigation(f"half the exposure time (shutter.exposure_time_s: {half:g})", {self.kind: 0.25})


class TemporalNoiseSource(SensorSource):
    """Shot noise, readout noise, and the noise of the Gaussian sensor."""

    kind = "noise"
    title = "sensor noise"
    effects = ("gaussian_noise", "shot_noise", "readout_noise")

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the noise of a grey value at half of full scale."""
        if getattr(scene.sensor, "kind", "") == "gaussian":
            return f"{100 * float(getattr(scene.sensor, 'noise_std', 0.0)):g} % of full scale"
        return f"{format_two_digits(100 * self.deviation(scene))} % of full scale"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a measure that halves the noise."""
        kinds = {effect.kind for effect in build_sensor_chain(scene.sensor).effects}
        if "gaussian_noise" in kinds:
            value = float(getattr(scene.sensor, "noise_std", 0.0)) / 2
            field = f"noise {100 * value:g} % of full scale" if value else "half the noise"
            return Mitigation(f"the mean of four images ({field})", {self.kind: 0.5})
        return Mitigation("the mean of four images, or four times the light and full well", {self.kind: 0.5})


_BITS = 16


class QuantisationSource(SensorSource):
    """Rounding to digital numbers; switched off, these have 16 bits."""

    kind = "quantisation"
    title = "quantisation"

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether digital numbers have less than 16 bits."""
        return 0 < self._bits(scene) < _BITS

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Set digital numbers to 16 bits, and scale the gain accordingly."""
        if not isinstance(plain["sensor"], dict):
            return
        effects = plain["sensor"]["effects"]
        more = sum(_BITS - one["bit_depth"] for one in effects if one["kind"] == "digitisation")
        for one in effects:
            if one["kind"] == "digitisation":
                one["bit_depth"] = _BITS
            if one["kind"] == "gain":
                one["gain_dn_per_e"] *= 2**more
                one["black_level_dn"] *= 2**more

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the bit depth and the standard deviation of rounding."""
        bits = self._bits(scene)
        return f"{bits} bits, {format_two_digits(100 / np.sqrt(12) / (2**bits - 1))} % of full scale"

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return four more bits, up to 16."""
        more = min(4, _BITS - self._bits(scene))
        return Mitigation(f"{more} more bits (sensor.bit_depth: {self._bits(scene) + more})", {self.kind: 2.0**-more})

    def _bits(self, scene: Scene) -> int:
        bits = [
            getattr(one, "bit_depth", 0)
            for one in build_sensor_chain(scene.sensor).effects
            if one.kind == "digitisation"
        ]
        return int(bits[0]) if bits else 0


class ShadingSource(UncertaintySource):
    """Change of shading of moving surfaces, without a model: always simulated; switched off, the scene is unlit."""

    kind = "shading"
    title = "shading"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"lighting.lights": [], "lighting.ambient": None}
    takes_contrast = True
    coarse = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether there are lamps; ambient light is uniform."""
        return bool(scene.lighting.lights)

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the number of lamps."""
        count = len(scene.lighting.lights)
        return f"{count} lamp{'s' if count > 1 else ''}"

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Remove the lamps; a scene with ambient light only is not changed."""
        if plain["lighting"]["lights"]:
            super().switch_off(plain)

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation | None:
        """Return a method with a photometric model per image."""
        if scene.estimate.method == "refined":
            return Mitigation("uniform light from all sides (lighting: {ambient: 1})", {self.kind: 0.1})
        words = "a method that models changes of illumination (method refined)"
        return Mitigation(words, {self.kind: 0.05, "brightness": 0.05, "slope": 0.01})


class SpecularSource(UncertaintySource):
    """Gloss of materials, whose highlights slide over surfaces; switched off, these are matt. Without a model."""

    kind = "specular"
    title = "gloss"
    group = "images"
    on_contrast = True
    coarse = True

    def is_on(self, scene: Scene, calibration: Calibration) -> bool:
        """Return whether a material has gloss; materials of mesh files may have it."""
        return bool(self._glossy(scene)) or any(part.material.from_file for _, part in scene.parts)

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the smallest roughness of glossy materials."""
        found = self._glossy(scene)
        return f"roughness {min(found):g}" if found else "materials of files"

    def switch_off(self, plain: dict[str, Any]) -> None:
        """Make all materials matt; they transmit as before, unless they are those of a file."""
        for owner in (*plain["objects"], *plain["plants"]):
            if owner.get("material"):
                owner["material"] |= {"refractive_index": 1.0, "metallic": 0.0, "from_file": False}

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return images without their smooth part, or crossed polarisers."""
        words = "images less their mean over a Gaussian of 2 px, or crossed polarisers before lamps and camera"
        return Mitigation(words, {self.kind: 0.1})

    def _glossy(self, scene: Scene) -> list[float]:
        """Return the roughness of the materials with gloss."""
        materials = [part.material for _, part in scene.parts]
        return [item.roughness for item in materials if item.refractive_index > 1 or item.metallic > 0]


class VignettingSource(UncertaintySource):
    """Decrease of brightness towards the corners, which changes the grey value of a point between images."""

    kind = "vignetting"
    title = "vignetting"
    group = "images"
    perfect: ClassVar[Mapping[str, Any]] = {"optics.vignetting": None}
    takes_contrast = True
    coarse = True

    def size(self, scene: Scene, calibration: Calibration) -> str:
        """Return the relative brightness in a corner."""
        vignetting = scene.optics.vignetting
        return "" if vignetting is None else f"{100 * float(vignetting.factor(scene.camera)[0, 0]):.0f} % in a corner"

    def disturbances(self, sight: ObservationModel) -> Iterable[Disturbance]:
        """Yield the change of brightness between images."""
        vignetting = sight.scene.optics.vignetting
        if vignetting is None:
            return
        factor = vignetting.factor(sight.scene.camera)
        gradient = np.gradient(factor)

        def change(s: int, t: int) -> ImageDisturbance:
            place = sight.place(s, t)
            apart = gradient[1] * (place.x - sight.points.x) + gradient[0] * (place.y - sight.points.y)
            # The texture of the reference is already darkened.
            return ImageDisturbance(grey=sight.texture * apart / np.maximum(factor, 1e-6))

        yield change

    def remedy(self, scene: Scene, calibration: Calibration) -> Mitigation:
        """Return a flat-field correction."""
        return Mitigation("images divided by that of a uniform light field", {self.kind: 0.1})
