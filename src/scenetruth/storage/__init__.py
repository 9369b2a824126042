"""Data sets on disk: stores with checksums, written and read image by image, and images as files."""

from scenetruth.storage.images import is_image_name, write_images
from scenetruth.storage.names import RECORDING, SCENE, TRUTH, store_name
from scenetruth.storage.reading import Kind, load, open_store
from scenetruth.storage.saving import save, write_store
from scenetruth.storage.store_claim import claim_store, is_store
from scenetruth.storage.store_files import files_of, is_zip_name
from scenetruth.storage.store_writer import StoreWriter
from scenetruth.storage.verifying import verify_store

__all__ = [
    "RECORDING",
    "SCENE",
    "TRUTH",
    "Kind",
    "StoreWriter",
    "claim_store",
    "files_of",
    "is_image_name",
    "is_store",
    "is_zip_name",
    "load",
    "open_store",
    "save",
    "store_name",
    "verify_store",
    "write_images",
    "write_store",
]
