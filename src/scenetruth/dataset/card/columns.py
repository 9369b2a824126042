"""Columns of the catalogue in words."""

from __future__ import annotations

from scenetruth.dataset.catalogue.statistics import STATISTICS
from scenetruth.dataset.pages.labels import bracketed, label_of
from scenetruth.dataset.sampler import Sampler

__all__ = ["VALUE", "describe_column"]

VALUE = "value."
"""What names of columns with drawn values begin with."""
_FIXED = {
    "sample": "number of the sample, which names its folder",
    "draw": "number of the draw that it belongs to; all steps of a ladder share it",
    "step": "0 for the sample as it was drawn, then the steps of the ladders",
    "factor": "path of what the step changes; empty for step 0",
    "split": "name of its split; empty if there are none",
    "base": "number of the base scene in the recipe",
    "attempts": "how many draws it took until one was accepted",
    "rejected": "why the draws before were refused, in order",
    "scene_seed": "seed of textures, noise and stage errors",
    "scene_hash": "hash of everything in the scene that images and truth depend on",
    "recording_hash": "hash of that, and of the backend that rendered",
    "backend": "what rendered it",
    "seconds": "time that it took, in s; unlike all else it differs from run to run",
    "warnings": "warnings that its making gave",
    "bytes": "size of its files together",
    "shard": "number of the tar file that holds it",
    "objects": "what is seen of each object: name, share of the image, share of that which all cameras see, depths",
}
_FILES = {"scene": "scene.yaml", "recording": "recording.zarr.zip", "truth": "truth.zarr.zip"}
_OF_FILES = {"sha256": "SHA-256 of {}", "bytes": "size of {} in bytes"}


def describe_column(name: str, sampler: Sampler) -> str:
    """Return what a column of the catalogue holds.

    Parameters
    ----------
    name
        Name of the column.
    sampler
        The recipe, whose fields the columns of values are.
    """
    if name.startswith(VALUE):
        key = name.removeprefix(VALUE)
        told = bracketed(*label_of(key, sampler.bases[0].to_plain()))
        return f"what was drawn: {told}"
    if name in STATISTICS:
        return f"{STATISTICS[name]}; of the reference camera at the reference frame"
    file, _, what = name.rpartition("_")
    if file in _FILES and what in _OF_FILES:
        return _OF_FILES[what].format(_FILES[file])
    return _FIXED.get(name, name.replace("_", " "))
