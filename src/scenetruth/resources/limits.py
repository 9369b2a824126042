"""Limits that a scene may exceed only if the user raises them, and values that are most likely an error of unit."""

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
    """Bounds of what a scene file may ask for, and of what it may take of the machine.

    Each of the first is such that what lies within it alone stays within a few gigabytes: who passes one, by a slip of
    the pen or because a file came from elsewhere, is asked first. The last are what the machine has if not given.

    Parameters
    ----------
    frames
        Frames: ten thousand are a week at one frame a minute.
    images
        Images of all positions and frames.
    pixels
        Pixels of one image, 4000 x 4000: images and maps take 320 bytes a pixel while they are made.
    samples
        Samples that an image is the mean of in every pixel: of the quadrature, the aperture and the exposure together.
    vertices
        Vertices of all meshes together; with its two triangles, each takes two kilobytes, by OpenGL four.
    objects
        Objects, leaves among them: to look at so many takes `check` about a second.
    leaves
        Leaves of all plants; the texture of a large leaf takes 50 MB.
    texels
        Points of one texture, 8000 x 8000; decoded and painted, they take a gigabyte.
    image_pixels
        Pixels of an image file.
    memory_gb, disk_gb
        Memory and disk space that may be foreseen, in 1e9 bytes, whatever the machine has; None: what it has.
    hours
        Time that may be foreseen; None: any.

    See Also
    --------
    simulate, run_scene : Take it as ``limits``.
    MachineError : Tells what is more than the machine has.

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
    """Return limits with some of them changed.

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
            message = f"must read name=value, as frames=20000; the names are {', '.join(names)}"
            problems.append(Problem("--limit", message, word))
        elif not _NUMBER.fullmatch(text.strip()) or float(text) <= 0:
            problems.append(Problem(f"--limit {name}", "must be a positive number", text))
        else:
            changes[name] = float(text)
    if problems:
        raise SceneError(problems)
    return replace(Limits(), **changes)


# Not more digits than a number needs that is finite.
_NUMBER = re.compile(r"[0-9_]{1,18}(\.[0-9]{0,9})?([eE][+-]?[0-9]{1,2})?", re.ASCII)


def too_much(name: str, values: Sequence[tuple[str, float]], limits: Limits, what: str) -> list[Problem]:
    """Return problems of values that pass a bound."""
    most = getattr(limits, name)
    remedy = "make it less, or allow it: --limit"
    return [
        Problem(path, f"makes {value:,.0f} {what}, more than {most:,.0f}; {remedy} {name}={_up(value)}")
        for path, value in values
        if value > most
    ]


def _up(value: float) -> str:
    """Spell a number of two digits that is not less."""
    size = 10 ** max(len(str(int(value))) - 2, 0)
    return str(-int(-value // size) * size)


_MOST_NOISE = 0.5
"""Noise that covers half of all grey values leaves no image; that of cameras is a few hundredths."""
_MOST_GROWTH_PER_HOUR = 1.0
"""What grows by 100 % in an hour is no plant: the fastest leaves grow by some per cent."""
_LEAST_FOCAL_WIDTHS = 0.1
"""Focal length, in widths of the image, at which 157 degrees are seen: no lens without distortion sees as much."""


def find_unit_errors(scene: Scene) -> list[str]:
    """Return warnings of values that are most likely meant in another unit, each with what was meant.

    >>> import scenetruth as st
    >>> print(*find_unit_errors(st.load_scene("cube", overrides=["sensor={noise_std: 2}"])))
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
