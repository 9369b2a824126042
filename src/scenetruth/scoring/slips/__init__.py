"""Slips of convention: an estimate with the wrong sign, unit, origin or order, told from the truth."""

from scenetruth.scoring.slips.find import find_slips, slips_of_arrays
from scenetruth.scoring.slips.slip import Slip

__all__ = ["Slip", "find_slips", "slips_of_arrays"]
