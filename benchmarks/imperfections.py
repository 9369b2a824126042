"""Measure what each imperfection of camera, stage, light and sensor costs both methods on the noise cube.

Run it from the top of the repository: ``python -m benchmarks.imperfections [NAME ...]``; 640 x 480 pixels, 5 cameras, 9
frames, of which one is estimated; pixels 20 px and more from edges. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

from collections.abc import Sequence

import scenetruth as st
from benchmarks.beside import METHODS, scene_of
from benchmarks.jobs import arguments, ends, heading, line

IDEAL = ["sensor=ideal", "render.backend=raycast", "render.supersampling=4"]

# Each effect alone, at the size it has on a common rig; fewer samples per pixel where many images are averaged.
_FEWER = "render.supersampling=2"
EFFECTS: dict[str, list[str]] = {
    "none": [],
    "Gaussian noise 1 %, 8 bit": ["sensor={noise_std: 0.01, bit_depth: 8}"],
    "scientific CMOS": ["sensor={kind: emva1288, preset: scientific_cmos}"],
    "industrial CMOS": ["sensor={kind: emva1288, preset: industrial_cmos}"],
    "CCD of about 2002": ["sensor={kind: emva1288, preset: ccd_2002}"],
    "point spread, Gaussian, 0.7 px": ["optics.psf={kind: gaussian, sigma_px: 0.7}"],
    "diffraction, f/16, 0.55 µm, 3.45 µm pixels": [
        "optics.psf={kind: airy, wavelength_um: 0.55, f_number: 16, pixel_pitch_um: 3.45}"
    ],
    "defocus, aperture 3 mm, focus at 660 mm": ["optics.defocus={aperture_mm: 3, focus_distance_mm: 660}", _FEWER],
    "vignetting, cos⁴ and 20 % in the corners": ["optics.vignetting={coefficients: [-0.2, 0, 0]}"],
    "distortion, 1 px in the corners": ["camera.distortion={k1: -0.4}"],
    "exposure of half the frame": ["shutter.exposure_time_s=0.5", _FEWER],
    "stage moving 10 µm per exposure": ["shutter={exposure_time_s: 0.01, stage_speed_mm_per_s: 1.0}", _FEWER],
    "rolling shutter, 0.1 frame": ["shutter.readout_time_s=0.1", _FEWER],
    "screw stage": ["stage.errors={preset: screw_stage}"],
    "air bearing": ["stage.errors={preset: air_bearing}"],
    "0.1 frame per position": ["stage.time_per_position_s=0.1"],
    "brightness drifting 1 % per frame": ["lighting.drift_per_frame=0.01"],
}
QUANTITIES = ("depth", "disparity", "velocity_x", "velocity_y", "velocity_z", "flow_x", "flow_y")
COLUMNS = ("depth mm", "disparity px/step", "U_X mm/frame", "U_Y", "U_Z", "flow x px/frame", "y", "density")


def rows(name: str, changes: Sequence[str]) -> list[list[str]]:
    """Simulate an effect, and return what each method makes of it, by its defaults."""
    recording, truth = st.simulate(scene_of("cube", [*IDEAL, *EFFECTS[name], *changes]))
    cells = []
    for method in METHODS:
        scores = st.score(st.estimate(recording, method), truth).regions["interior"]
        told = [f"{scores[quantity]['rmse'] or float('nan'):.2g}" for quantity in QUANTITIES]
        cells.append([name, method, *told, f"{float(scores['depth']['density'] or 0):.2f}"])
    return cells


def main() -> None:
    """Print the table, effect by effect."""
    given = arguments(__doc__).parse_args()
    print(heading(("effect, alone", "method", *COLUMNS)), flush=True)
    for _, cells in ends(rows, {name: (name, given.set) for name in EFFECTS}, given):
        print("\n".join(map(line, cells)), flush=True)


if __name__ == "__main__":
    main()
