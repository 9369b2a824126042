"""The moments that a scene is looked at."""

from __future__ import annotations

from scenetruth.scene.spec import Scene

__all__ = ["times_of"]


def times_of(scene: Scene) -> list[float]:
    """Return the times of the frames, and those of the first and of the last image, in frames."""
    stage, frames = scene.stage, scene.frames.t.tolist()
    per_image = stage.time_per_position_s / scene.frames.frame_interval_s
    before, last = stage.number_in_scan(0, frames[0]), stage.number_in_scan(0, frames[-1])
    after = stage.positions * stage.rows - 1 - last
    ends = [frames[0] - before * per_image, frames[-1] + after * per_image] if per_image > 0 else []
    return [*map(float, frames), *ends]
