"""Limits that a scene may exceed only if the user raises them, and checks for values given in the wrong unit."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace

from scenetruth.camera import GaussianSensor
from scenetruth.errors import Problem, SceneError
from scenetruth.scene.deformation import Growth
from scenetruth.scene.scene_models import Scene

__all__ = ["Limits", "find_unit_errors", "limits_from", "too_much"]


@dataclass(frozen=True)
class Limits:
    """Limits on the contents of a scene file and on the resources of the machine.

    Within each limit on the contents, the work takes a few gigabytes of memory. A scene beyond a limit, by mistake or
    from another source, is rejected unless the limit is raised. By default, memory and disk space of the machine apply.

    Parameters
    ----------
    frames
        Number of frames; 10 000 cover a week at one frame per minute.
    images
        Number of images of all positions and frames.
    pixels
        Pixels of one image (4000 x 4000); rendering takes 320 bytes per pixel.
    samples
        Samples per pixel over which an image is averaged: supersampling, aperture and exposure combined.
    vertices
        Vertices of all meshes; with its two triangles, each takes 2 kB, with OpenGL 4 kB.
    objects
        Number of objects including leaves; `check` takes about 1 s for this number.
    leaves
        Leaves of all plants; the texture of a large leaf takes 50 MB.
    texels
        Texels of one texture (8000 x 8000); they take 1 GB.
    image_pixels
        Pixels of an image file.
    memory_gb, disk_gb
        Limit of the estimated memory and disk space in 1e9 bytes; None: what is available on the machine.
    hours
        Limit of the estimated run time; None: unlimited.

    See Also
    --------
    simulate, run_scene : Use it as ``limits``.
    MachineError : Raised if the machine has too few resources.

    Examples
    --------
    >>> Limits(frames=20_000).frames, Limits().frames
    (20000, 10000)
    """

    frames: float = 10_000
    images: float = 100_000
    pixels: float = 16_000_000
    samples: float = 4_096
    vertices: float = 1_000_000
    objects: float = 400
    leaves: float = 100
    texels: float = 64_000_000
    image_pixels: float = 64_000_000
    memory_gb: float | None = None
    disk_gb: float | None = None
    hours: float | None = None


def limits_from(words: Iterable[str]) -> Limits:
    """Return limits with some values replaced.

    >>> limits_from(["frames=2e4", "memory_gb=64"]).memory_gb
    64.0
    """
    names = [field.name for field in fields(Limits)]
    changes: dict[str, float] = {}
    problems = []
    for word in words:
        name, separator, text = word.partition("=")
        name = name.strip()
        if not separator or name not in names:
            message = f"must have the form name=value, as in frames=20000; the names are {', '.join(names)}"
            problems.append(Problem("--limit", message, word))
        elif not _NUMBER.fullmatch(text.strip()) or float(text) <= 0:
            problems.append(Problem(f"--limit {name}", "must be a positive number", text))
        else:
            changes[name] = float(text)
    if problems:
        raise SceneError(problems)
    return replace(Limits(), **changes)


# No more digits than a finite number requires.
_NUMBER = re.compile(r"[0-9_]{1,18}(\.[0-9]{0,9})?([eE][+-]?[0-9]{1,2})?", re.ASCII)


def too_much(name: str, values: Sequence[tuple[str, float]], limits: Limits, what: str) -> list[Problem]:
    """Return the problems of values that exceed a limit."""
    most = getattr(limits, name)
    remedy = "reduce it or set --limit"
    return [
        Problem(path, f"results in {value:,.0f} {what}, more than {most:,.0f}; {remedy} {name}={_up(value)}")
        for path, value in values
        if value > most
    ]


def _up(value: float) -> str:
    """Return a number rounded up to two digits."""
    size = 10 ** max(len(str(int(value))) - 2, 0)
    return str(-int(-value // size) * size)


_MOST_NOISE = 0.5  # noise of half the full scale leaves no usable image; camera noise is a few hundredths
_MOST_GROWTH_PER_HOUR = 1.0
"""Growth of 100 % per hour is not plausible for a plant: the fastest leaves grow by a few per cent per hour."""
_LEAST_FOCAL_WIDTHS = 0.1
"""Focal length in image widths that gives a field of view of 157 degrees, beyond any distortion-free lens."""


def find_unit_errors(scene: Scene) -> list[str]:
    """Return warnings about values that are probably given in the wrong unit, each with the expected unit.

    >>> import scenetruth as st
    >>> print(*find_unit_errors(st.load_scene("cube", overrides=["sensor={noise_std: 2}"])))
    sensor.noise_std: is 2 times full scale, which hides the image; specify a fraction, 0.01 is 1 % of full scale
    """
    return [*_noise(scene), *_growth(scene), *_focal_length(scene)]


def _noise(scene: Scene) -> Iterator[str]:
    if isinstance(scene.sensor, GaussianSensor) and scene.sensor.noise_std > _MOST_NOISE:
        yield (
            f"sensor.noise_std: is {scene.sensor.noise_std:g} times full scale, which hides the image; specify a "
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
        # A stretched surface becomes narrower as it gets longer, possibly at a high rate.
        if not isinstance(entry, Growth) or not 0 <= (entry.along_share or 0) <= 1:
            continue
        if abs(entry.rate_per_hour) > _MOST_GROWTH_PER_HOUR:
            yield (
                f"{path}.rate_per_hour: is {100 * entry.rate_per_hour:g} % per hour; specify a fraction of the area, "
                "0.03 is 3 %/h"
            )


def _focal_length(scene: Scene) -> Iterator[str]:
    camera = scene.camera
    if camera.focal_length_px is not None and camera.focal_length_px < _LEAST_FOCAL_WIDTHS * camera.width:
        yield (
            f"camera.focal_length_px: is {camera.focal_length_px:g} px for an image of {camera.width} px, a field of "
            "view of nearly 180 degrees; the unit is px, not mm: for mm, specify focal_length_mm and pixel_pitch_um"
        )
