"""Compare error bars with the scatter of estimates from many noisy recordings, and print tables in Markdown.

Run it from the top of the repository: ``python -m benchmarks.calibration``. The refined method has a third of the
recordings; the cube, 640 x 480 pixels, a quarter of them, and a fiftieth for the refined method. ``--seeds 3 --small``
tries planes only. The waves of the plaids repeat: the refined method has no valid pixels there.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

import scenetruth as st
from tests.helpers.analytic_plane import Plane
from tests.helpers.noise_calibration import NOISE, calibration
from tests.helpers.scenes import SCENES, plaid

PARTS = ("Z", "U_X", "U_Y", "U_Z")
REFINED = {"method": "refined"}


def row(name: str, recording: Any, truth: Any, seeds: int, inner: dict[str, slice], **settings: Any) -> None:
    """Print scatter over prediction, and the share of the truth within two standard deviations."""
    method = settings.setdefault("method", "structure_tensor")
    if method == "structure_tensor":
        settings["flow_working_point_px"] = (0, 0)
    found = calibration(recording, truth, seeds, inner, told_only=True, **settings)
    ratios = " | ".join(f"{found[part][0]:.2f}" for part in PARTS)
    shares = " | ".join(f"{100 * found[part][1]:.1f}" for part in PARTS)
    print(f"| {name} | {method} | {ratios} | {shares} |", flush=True)


def noise_of_plaid(seeds: int) -> None:
    """Print the rms relative errors of u_x, u_z and Z in the middle of eq. 13 with noise, over phases and seeds."""
    camera = {"width": 33, "height": 33, "focal_length_px": 10}
    cases = {
        "U_X = 1": ((1.0, 0, 0), 1.0, "flow"),
        "U_X = 4": ((4.0, 0, 0), 1.0, "flow"),
        "U_Z = 1": ((0, 0, 1.0), 1.0, "divergence"),
        "Z at V_X = 4": ((0, 0, 0), 4.0, "depth"),
    }
    print("\n| relative rms error, noise 0.025 | λ = 4 | 8 | 16 | 32 |\n|---|---|---|---|---|")
    for name, (velocity, baseline, quantity) in cases.items():
        cells = []
        for wavelength in (4, 8, 16, 32):
            errors = []
            for seed in range(seeds):
                generator = np.random.default_rng(seed)
                phase = tuple(generator.uniform(0, 360, 2))
                scene = plaid(wavelength, velocity, phase_deg=phase, camera=camera, baseline_mm=baseline)
                recording, truth = st.simulate(scene)
                noise = generator.normal(0, NOISE / 2, recording["image"].shape)
                noisy = recording.assign(image=(recording["image"].dims, recording["image"].values + noise))
                estimate = st.estimate(
                    noisy, working_point_px=0, flow_working_point_px=(0, 0), divergence="paper", tau=0.0
                )
                middle, exact = (data.sel(t=0, x=16, y=16) for data in (estimate, truth))
                if quantity == "divergence":
                    errors.append(float(middle["divergence"] * -exact["depth"] / velocity[2]) - 1)
                else:
                    values = (np.ravel(data[quantity].values)[0] for data in (middle, exact))
                    errors.append(next(values) / next(values) - 1)
            cells.append(f"{np.sqrt(np.mean(np.square(errors))):.1e}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--small", action="store_true", help="without the cube and the noise of plaids")
    given = parser.parse_args()
    seeds = given.seeds
    print("| recording, noise 0.025 | method | Z | U_X | U_Y | U_Z | Z % | U_X % | U_Y % | U_Z % |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    inner = {"y": slice(16, -16, 2), "x": slice(16, -16, 2)}
    for wavelength in (4, 8, 16, 32):
        velocity = (1.0, 0.5, 0.5)
        recording, _ = st.simulate(plaid(wavelength, velocity))
        truth: dict[str, Any] = {"depth": 100.0, "velocity": np.array(velocity)}
        row(f"plaid, λ = {wavelength} px", recording, truth, seeds, inner, working_point_px=0)
    plane = Plane(velocity=(0.1, -0.05, 0.3), size=(64, 84))
    inner = {"y": slice(16, -16, 2), "x": slice(24, -24, 2)}
    for cameras, frames in ((5, 9), (2, 9), (9, 9), (5, 2), (5, 5)):
        recording = plane.recording(np.arange(cameras) - (cameras - 1) // 2, frames)
        truth = {"depth": 500.0, "velocity": np.array(plane.velocity)}
        row(f"plane, {cameras} cameras, {frames} frames", recording, truth, seeds, inner, working_point_px=2)
        row(f"plane, {cameras} cameras, {frames} frames", recording, truth, max(seeds // 3, 3), inner, **REFINED)
    if given.small:
        return
    recording, maps = st.simulate(
        st.load_scene(SCENES / "cube.yaml", overrides=["sensor=ideal", "render.backend=raycast"])
    )
    inner = {"y": slice(200, 400, 8), "x": slice(120, 520, 8)}
    exact = maps.sel(t=0).isel(inner)
    truth = {"depth": exact["depth"].values, "velocity": exact["velocity"].values}
    for name, settings in {
        "cube, one working point": {"working_point_px": "auto"},
        "cube, per pixel": {"working_point_px": "per_pixel"},
        "cube, per pixel, noise from the residual": {"working_point_px": "per_pixel", "noise_std": "auto"},
    }.items():
        row(name, recording, truth, max(seeds // 4, 10), inner, **({"noise_std": NOISE} | settings))
    row("cube", recording, truth, max(seeds // 50, 4), inner, **REFINED)
    noise_of_plaid(seeds)


if __name__ == "__main__":
    main()
