"""Shape of the pair of the Stereo-DIC Challenge by pyvale: ``python stereo_pyvale.py JSON``, in its own environment."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np


def main() -> None:
    """Match, and write pixels and points."""
    from pyvale import calib, data, dic

    job = json.loads(sys.argv[1])
    references = [data.dic_chal_3d_cam0(), data.dic_chal_3d_cam1()]
    left, top, width, height = job["box"]
    region = np.zeros((2048, 2448), bool)
    region[top : top + height, left : left + width] = True
    with tempfile.TemporaryDirectory() as work:
        dic.calculate_3d(
            reference=references,
            deformed=references,
            calibration=calib.loadtxt(data.dic_ex10_dic_chal_calibration(), delimiter=","),
            roi_mask=region,
            seed=[[left + width // 2, top + height // 2]],
            subset_size=job["subset"],
            subset_step=job["step"],
            precision=1e-5,
            output_basepath=work,
            print_level=0,
        )
        found = dic.import_3d(sorted(map(str, Path(work).glob("*.csv"))), ",", layout="column", print_level=0)
    z = np.asarray(found.stereo.z_mm[0], dtype=np.float64)
    known = np.isfinite(z) & (z != 0)
    parts = {"x_px": found.ss_x, "y_px": found.ss_y, "z_mm": z}
    parts |= {"x_mm": found.stereo.x_mm[0], "y_mm": found.stereo.y_mm[0]}
    np.savez(job["output"], **{name: np.asarray(each, dtype=np.float64)[known] for name, each in parts.items()})


if __name__ == "__main__":
    main()
