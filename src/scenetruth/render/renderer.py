"""The interface of the render backends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from scenetruth.camera import Viewpoint

__all__ = ["Renderer"]


class Renderer(Protocol):
    """Renders images of one world with one camera. It holds resources until it is closed, or its with block ends."""

    name: str
    """The backend and its platform: ``pyrender (osmesa)``."""

    def render(self, t: float, viewpoint: Viewpoint) -> NDArray[np.float32]:
        """Render one image.

        Returns: Linear radiance, shape (height, width), float32; every pixel is the mean over its footprint [x ± 1/2] x
        [y ± 1/2], whose centre has the integer coordinates (x, y).
        """
        ...

    def render_all(self, moments: Iterable[tuple[float, Viewpoint]]) -> Iterator[NDArray[np.float32]]:
        """Render images one after the other; some renderers begin the next while the caller works on the last."""
        for t, viewpoint in moments:
            yield self.render(t, viewpoint)

    def close(self) -> None:
        """Free all resources; closing twice is harmless."""
        ...

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
