"""Protocol of the rendering backends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint

__all__ = ["Renderer"]


class Renderer(Protocol):
    """Renderer for one scene and camera; holds resources until closed or until its with block ends."""

    name: str
    """Backend and platform: ``pyrender (osmesa)``."""

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Return the linear radiance, float32, averaged over the footprint [x ± 1/2] x [y ± 1/2] of each pixel."""
        ...

    def render_all(self, moments: Iterable[tuple[float, Viewpoint]]) -> Iterator[NDArray[np.float32]]:
        """Render consecutive images; implementations may render ahead while the caller processes the previous image."""
        for t, viewpoint in moments:
            yield self.render(t, viewpoint)

    def close(self) -> None:
        """Free all resources; repeated calls have no effect."""
        ...

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
