"""Hits and silhouettes at the pixels of images that are needed twice: for the image, and for its ground truth."""

from __future__ import annotations

from collections.abc import Iterable
from threading import Lock
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Camera, Viewpoint

__all__ = ["FirstFaces", "ImageHits", "image_hits"]

_MOST_BYTES = 1 << 24  # of all results that are kept: ten images of 640 x 480 px; further images are computed twice


class FirstFaces(NamedTuple):
    """Results of the rays through the pixel centres of an image.

    ``face``: First face hit, -1 for none, in row-major order, shape (height x width,).
    ``mixed``: Mixed pixels, see `mixed_pixels`, shape (height, width).
    """

    face: NDArray[np.int32]
    mixed: NDArray[np.bool_]


_Key = tuple[float, Camera, bytes, bytes, tuple[float, float]]


def _key(t: float, camera: Camera, viewpoint: Viewpoint) -> _Key:
    return (t, camera, viewpoint.position_mm.tobytes(), viewpoint.rotation.tobytes(), viewpoint.shear)


class ImageHits:
    """Results for the images of a scene that are needed again; several threads may use it."""

    def __init__(self) -> None:
        self._expected: set[_Key] = set()
        self._kept: dict[_Key, FirstFaces] = {}
        self._bytes = 0
        self._lock = Lock()

    def expect(self, camera: Camera, images: Iterable[tuple[float, Viewpoint]]) -> None:
        """Announce the time in frames and the viewpoint of images whose results are needed again, once each."""
        self._expected.update(_key(t, camera, viewpoint) for t, viewpoint in images)

    def expects(self, t: float, camera: Camera, viewpoint: Viewpoint) -> bool:
        """Return whether the results of an image are needed again, and not kept yet."""
        return bool(self._expected) and _key(t, camera, viewpoint) in self._expected

    def keep(self, t: float, camera: Camera, viewpoint: Viewpoint, found: FirstFaces) -> None:
        """Keep the results of an expected image, which must not be modified any more."""
        key, size = _key(t, camera, viewpoint), found.face.nbytes + found.mixed.nbytes
        with self._lock:
            if key in self._expected and self._bytes + size <= _MOST_BYTES:
                self._expected.remove(key)
                self._kept[key] = found
                self._bytes += size

    def take(self, t: float, camera: Camera, viewpoint: Viewpoint) -> FirstFaces | None:
        """Return the results of an image and forget them; None if they are not kept."""
        key = _key(t, camera, viewpoint)
        with self._lock:
            # Nobody needs them later.
            self._expected.discard(key)
            found = self._kept.pop(key, None)
            if found is not None:
                self._bytes -= found.face.nbytes + found.mixed.nbytes
        return found


_known: WeakKeyDictionary[object, ImageHits] = WeakKeyDictionary()
_alone = Lock()


def image_hits(world: object) -> ImageHits:
    """Return the results that images and ground truth of a scene have in common."""
    with _alone:
        found = _known.get(world)
        if found is None:
            found = _known[world] = ImageHits()
        return found
