"""Output of results: atomic, by one writer at a time, without replacing foreign files."""

from scenetruth.output.atomic_write import (
    check_output,
    is_full_disk,
    lock_output,
    remove_leftovers,
    scratch_path,
    write_atomically,
)
from scenetruth.output.destinations import check_writable
from scenetruth.output.ownership import (
    Claim,
    OwnershipResult,
    claim_file,
    claim_folder,
    claim_pictures,
    describe_foreign_files,
)

__all__ = [
    "Claim", "OwnershipResult", "check_output", "check_writable", "claim_file", "claim_folder", "claim_pictures",
    "describe_foreign_files", "is_full_disk", "lock_output", "remove_leftovers", "scratch_path", "write_atomically",
]  # fmt: skip
