"""Values that are most likely slips of a unit: noise in grey levels, growth in per cent, a focal length in mm."""

from __future__ import annotations

from collections.abc import Iterator

from scenetruth.camera import GaussianSensor
from scenetruth.scene.deformation.growth import Growth
from scenetruth.scene.spec import Scene

__all__ = ["slips_of_units"]

_MOST_NOISE = 0.5
"""Noise that covers half of all grey values leaves no image; that of cameras is a few hundredths."""
_MOST_GROWTH_PER_HOUR = 1.0
"""What grows by 100 % in an hour is no plant: the fastest leaves grow by some per cent."""
_LEAST_FOCAL_WIDTHS = 0.1
"""Focal length, in widths of the image, at which 157 degrees are seen: no lens without distortion sees as much."""


def slips_of_units(scene: Scene) -> list[str]:
    """Return warnings of values that are most likely meant in another unit, each with what was meant.

    Parameters
    ----------
    scene
        The scene; nothing of it is made.

    Examples
    --------
    >>> import scenetruth as st
    >>> print(*slips_of_units(st.load_scene("cube", ["sensor={noise_std: 2}"])))
    sensor.noise_std: is 2 times the full scale: nothing is seen but noise; it is a fraction, 0.01 is 1 % of full scale
    """
    return [*_noise(scene), *_growth(scene), *_focal_length(scene)]


def _noise(scene: Scene) -> Iterator[str]:
    if isinstance(scene.sensor, GaussianSensor) and scene.sensor.noise_std > _MOST_NOISE:
        yield (
            f"sensor.noise_std: is {scene.sensor.noise_std:g} times the full scale: nothing is seen but noise; it is a "
            "fraction, 0.01 is 1 % of full scale"
        )


def _growth(scene: Scene) -> Iterator[str]:
    given = [
        (f"objects.{index}.deformation.{number}", entry)
        for index, item in enumerate(scene.objects)
        for number, entry in enumerate(item.deformation)
    ]
    for path, entry in [
        *given,
        *((f"plants.{index}.growth", plant.growth) for index, plant in enumerate(scene.plants)),
    ]:
        # What is pulled gets narrower as it gets longer, at any rate.
        if not isinstance(entry, Growth) or not 0 <= (entry.along_share or 0) <= 1:
            continue
        if abs(entry.rate_per_hour) > _MOST_GROWTH_PER_HOUR:
            yield (
                f"{path}.rate_per_hour: is {100 * entry.rate_per_hour:g} % per hour; it is a fraction of the area, "
                "0.03 is 3 %/h"
            )


def _focal_length(scene: Scene) -> Iterator[str]:
    camera = scene.camera
    if camera.focal_length_px is not None and camera.focal_length_px < _LEAST_FOCAL_WIDTHS * camera.width:
        yield (
            f"camera.focal_length_px: is {camera.focal_length_px:g} px for an image of {camera.width} px, which sees "
            "nearly half a turn; it is in px, not mm: give focal_length_mm with pixel_pitch_um for mm"
        )
