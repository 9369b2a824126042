"""Two cameras, two frames: few images, at several textures and noise levels."""

from __future__ import annotations

from benchmarks.trust import Plain, noise, plane, rig

__all__ = ["GROUPS", "SCENES"]

TEXTURES = {"4 to 20 px": noise(4, 20), "8 to 60 px": noise(8, 60), "4 to 20 px, weak": noise(4, 20, 0.06)}


def few(cameras: int, frames: int, texture: Plain, noise_std: float) -> Plain:
    """Return a scene of a sheet in few images."""
    return rig(
        [plane(texture)], stage={"positions": cameras}, frames={"count": frames}, sensor={"noise_std": noise_std}
    )


SCENES: dict[str, Plain] = {
    f"{cameras} x {frames}, {name}, {noise_std:g}": few(cameras, frames, texture, noise_std)
    for cameras, frames in ((2, 2), (2, 3), (3, 2))
    for name, texture in TEXTURES.items()
    for noise_std in (0.002, 0.005, 0.01, 0.02)
}

GROUPS: dict[str, str] = {
    "two or three cameras and frames": r"",
}
"""Rows of the summary, and what the names of their scenes contain."""
