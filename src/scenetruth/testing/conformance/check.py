"""What a check is, and what a method must give for it to apply."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.deviation import NotApplicable

__all__ = ["Check", "Need"]


@dataclass(frozen=True)
class Need:
    """What a method must give, and its recordings must have, for a check to say anything.

    Parameters
    ----------
    any_of
        Quantities of which the estimate of the plain recording must know at least one somewhere, as of
        `comparing.scalar_maps`; none if empty.
    plain
        Whether the plain recording must have an estimate.
    odd_cameras, odd_frames
        Whether the recording must have an odd number of cameras or frames, so that the reference is in the middle.
    cameras, frames
        Least number of cameras and frames of the plain recording.
    """

    any_of: tuple[str, ...] = ()
    plain: bool = True
    odd_cameras: bool = False
    odd_frames: bool = False
    cameras: int = 1
    frames: int = 1

    def __str__(self) -> str:
        parts = [" or ".join(self.any_of)] if self.any_of else []
        parts += [f"{self.cameras} cameras"] if self.cameras > 1 else []
        parts += [f"{self.frames} frames"] if self.frames > 1 else []
        parts += ["an odd number of cameras"] if self.odd_cameras else []
        parts += ["an odd number of frames"] if self.odd_frames else []
        return ", ".join(parts) or "nothing"

    def demand(self, bench: Bench) -> None:
        """Leave if the check says nothing of a method.

        Raises
        ------
        NotApplicable
            With the reason.
        """
        plane = bench.plane
        for name, least, odd, count in (
            ("cameras", self.cameras, self.odd_cameras, plane.cameras),
            ("frames", self.frames, self.odd_frames, plane.frames),
        ):
            if count < least or (odd and count % 2 == 0):
                msg = f"needs {f'{least} {name}' if count < least else f'an odd number of {name}'}, not {count}"
                raise NotApplicable(msg)
        if self.plain:
            known = bench.maps
            if self.any_of and not any(name in known for name in self.any_of):
                msg = f"the method gives no {' and no '.join(self.any_of)}"
                raise NotApplicable(msg)


@dataclass(frozen=True)
class Check:
    """One demand on a method.

    Parameters
    ----------
    name
        What it is called: its module.
    says
        What it demands, one sentence.
    needs
        When it applies.
    function
        Raises `Deviation` if the method does not meet it, `NotApplicable` if it says nothing of the method.
    """

    name: str
    says: str
    needs: Need
    function: Callable[[Bench], None]

    def run(self, bench: Bench) -> None:
        """Try a method."""
        self.needs.demand(bench)
        self.function(bench)
