"""Data model of recordings, ground truth and estimates: names, dimensions, units and validation."""

from scenetruth.schema.acquisition import Acquisition, StageTolerances, read_acquisition, tolerance_attributes
from scenetruth.schema.attributes import (
    Intrinsics,
    check_same_run,
    digest,
    estimate_hash,
    flat_attributes,
    read_intrinsics,
    read_lineage,
    read_object_names,
    read_scene,
)
from scenetruth.schema.estimates import assemble_estimate, make_estimate
from scenetruth.schema.frame_assembly import (
    IncrementalDataset,
    Put,
    blank_estimate,
    blank_map,
    compute_depth_rate,
    put_each,
    put_estimate,
)
from scenetruth.schema.outline import DatasetOutline, with_indexes
from scenetruth.schema.pixel_grid import PixelGrid, compute_pixel_grid
from scenetruth.schema.recordings import image_to_grey, make_recording
from scenetruth.schema.validation import check_dataset
from scenetruth.schema.variables import (
    COMPONENTS,
    COORDINATES,
    DEMOSAICING,
    FORMAT_VERSION,
    NO_SURFACE,
    REASONS,
    STATUS_FALLBACK,
    STATUS_INVALID,
    STATUS_NORMAL,
    STATUS_VALID,
    VARIABLES,
    Variable,
    describe_variable,
    label,
    make_outline,
)

__all__ = [
    "COMPONENTS", "COORDINATES", "DEMOSAICING", "FORMAT_VERSION", "NO_SURFACE", "REASONS", "STATUS_FALLBACK",
    "STATUS_INVALID", "STATUS_NORMAL", "STATUS_VALID", "VARIABLES", "Acquisition", "DatasetOutline",
    "IncrementalDataset", "Intrinsics", "PixelGrid", "Put", "StageTolerances", "Variable", "assemble_estimate",
    "blank_estimate", "blank_map", "check_dataset", "check_same_run", "compute_depth_rate", "compute_pixel_grid",
    "describe_variable", "digest", "estimate_hash", "flat_attributes", "image_to_grey", "label", "make_estimate",
    "make_outline", "make_recording", "put_each", "put_estimate", "read_acquisition", "read_intrinsics",
    "read_lineage", "read_object_names", "read_scene", "tolerance_attributes", "with_indexes",
]  # fmt: skip
