"""The three data sets that every room exchanges, recording, truth and estimate: names, dimensions, units, checks."""

from scenetruth.schema.attributes import Intrinsics, intrinsics_of, object_names_of, scene_of
from scenetruth.schema.checking import check_dataset
from scenetruth.schema.estimate import make_estimate
from scenetruth.schema.filling import Filling, Put, blank_map
from scenetruth.schema.frame_by_frame import blank_estimate, depth_rate_of, put_each, put_estimate
from scenetruth.schema.identity import check_same_run, digest, estimate_hash, identity_of
from scenetruth.schema.labelling import label
from scenetruth.schema.pixels import PixelGrid, pixel_grid_of
from scenetruth.schema.recording import image_to_grey, make_recording
from scenetruth.schema.variables import (
    COMPONENTS,
    FORMAT_VERSION,
    KIND_FULL,
    KIND_NONE,
    KIND_NORMAL,
    NO_SURFACE,
    VARIABLES,
    Variable,
)

__all__ = [
    "COMPONENTS",
    "FORMAT_VERSION",
    "KIND_FULL",
    "KIND_NONE",
    "KIND_NORMAL",
    "NO_SURFACE",
    "VARIABLES",
    "Filling",
    "Intrinsics",
    "PixelGrid",
    "Put",
    "Variable",
    "blank_estimate",
    "blank_map",
    "check_dataset",
    "check_same_run",
    "depth_rate_of",
    "digest",
    "estimate_hash",
    "identity_of",
    "image_to_grey",
    "intrinsics_of",
    "label",
    "make_estimate",
    "make_recording",
    "object_names_of",
    "pixel_grid_of",
    "put_each",
    "put_estimate",
    "scene_of",
]
