"""Data sets on disk: Zarr stores with checksums, and image files."""

from scenetruth.storage.image_series import is_image_name, write_images
from scenetruth.storage.reader import StoreKind, load_store, open_store, verify_store
from scenetruth.storage.store_files import (
    RECORDING,
    SCENE,
    TRUTH,
    claim_store,
    is_store,
    is_zip_name,
    open_store_files,
    store_name,
)
from scenetruth.storage.writer import StoreWriter, save_store, write_store

__all__ = [
    "RECORDING", "SCENE", "TRUTH", "StoreKind", "StoreWriter", "claim_store", "is_image_name", "is_store",
    "is_zip_name", "load_store", "open_store", "open_store_files", "save_store", "store_name", "verify_store",
    "write_images", "write_store",
]  # fmt: skip
