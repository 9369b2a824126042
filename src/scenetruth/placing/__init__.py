"""How results come under their names: written beside, put there when whole, and never in place of what is not ours."""

from scenetruth.placing.aside import check_output, hold, is_full_disk, scratch_beside, sweep_inside, write_aside
from scenetruth.placing.claims import Claim, Claimed, claim_file, claim_folder, claim_pictures, holds

__all__ = [
    "Claim",
    "Claimed",
    "check_output",
    "claim_file",
    "claim_folder",
    "claim_pictures",
    "hold",
    "holds",
    "is_full_disk",
    "scratch_beside",
    "sweep_inside",
    "write_aside",
]
