"""Cropping the images changes nothing inside: pixels keep their indices, the principal point stays."""

from __future__ import annotations

from scenetruth.testing.conformance.bench import Bench
from scenetruth.testing.conformance.check import Need
from scenetruth.testing.conformance.comparing import scalar_maps

__all__ = ["NEEDS", "check"]

NEEDS = Need()
_COLUMNS, _ROWS = 16, 12
_BORDER_PX = 20
"""Closer to the new border, windows of usual size have changed."""


def check(bench: Bench) -> None:
    """Take columns off on the left and rows off above."""
    recording = bench.recording().isel(x=slice(_COLUMNS, None), y=slice(_ROWS, None))
    found = scalar_maps(bench.estimate_if_it_suits(recording))
    inside = {
        name: item.where((item["x"] >= _COLUMNS + _BORDER_PX) & (item["y"] >= _ROWS + _BORDER_PX))
        for name, item in bench.maps.items()
    }
    bench.agrees(
        found,
        inside,
        done=f"the recording was cropped by isel: {_COLUMNS} columns on the left and {_ROWS} rows above went away",
        expectation=f"the same estimate more than {_BORDER_PX} px inside, within three times the method's own error",
        remedy="take pixel indices from recording['x'] and recording['y'], not from the array: "
        "scenetruth.schema.pixel_grid_of(recording)",
    )
