"""Names of what a simulation leaves in its folder."""

from __future__ import annotations

__all__ = ["RECORDING", "SCENE", "TRUTH", "store_name"]

SCENE = "scene.yaml"
"""The scene with all defaults and overrides."""

RECORDING = "recording"
"""The images; a store."""

TRUTH = "truth"
"""The exact maps; a store."""


def store_name(stem: str, *, zipped: bool) -> str:
    """Return the name of a store: of a folder, or of a zip file.

    Examples
    --------
    >>> store_name(TRUTH, zipped=False), store_name("estimate", zipped=True)
    ('truth.zarr', 'estimate.zarr.zip')
    """
    return f"{stem}.zarr" + (".zip" if zipped else "")
