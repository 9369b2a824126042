"""Simulations leave nothing behind in memory."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.helpers.nightly import nightly

SIMULATIONS = """
import gc, sys, warnings
from pathlib import Path
import scenetruth as st
warnings.simplefilter("ignore")
wall = {"name": "wall", "mesh": {"kind": "box", "size_mm": [40, 40, 40]}, "pose": {"position_mm": [0, 0, 100]}}
wall |= {"texture": {"kind": "noise", "wavelength_mm": [6, 20]}}
plain = {"camera": {"width": 80, "height": 60, "focal_length_px": 100}, "objects": [wall], "frames": {"count": 2}}
plain |= {"stage": {"positions": 3, "baseline_mm": 5}, "render": {"backend": sys.argv[1]}}

def resident_pages():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1])

for number in range(500):
    st.simulate(st.Scene.from_dict({**plain, "seed": number}))
    if number in (99, 499):
        print(resident_pages())
"""


@nightly
@pytest.mark.parametrize("backend", ["raycast", "pyrender"])
def test_resident_memory_is_flat_over_five_hundred_simulations(backend: str) -> None:
    done = subprocess.run([sys.executable, "-c", SIMULATIONS, backend], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    early, late = map(int, done.stdout.split())
    print(f"{backend}: {early} pages after 100 simulations, {late} after 500")
    assert late < 1.05 * early
