"""Measuring the drift of a leaf that sways in the wind: the computations of wind_sway.md.

Run it from the top of the repository:
``python docs/results/worked_examples/wind_sway.py scan|rates|periods|plans|bursts``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import scenetruth as st
from scenetruth.scene import Scene

FILE = Path(__file__).parents[3] / "scenes" / "windy_leaf.yaml"
RATE_HZ = 50.0
"""Frames per second of the scene file, whose curves count in frames."""
PERIODS_S, ALL_PERIODS_S = (2.1, 0.73), (2.1, 1.3, 0.73)
"""Periods visible in depth, and all periods; the period of 1.3 s is lateral sway."""
DRIFT = -0.1
"""mm per minute along Z: the leaf rises towards the camera."""
SHOT_MM, BURST_MM, BURST_MM_PER_S = 0.175, 0.078, 2.8
"""Standard deviations at a pixel, predicted by ``scenetruth check``: of depth from one shot (``frames.count=1``)
and from a burst of five frames, and of U_Z from a burst (0.055 mm per frame)."""
SOIL_MM = 625.0
"""Depth beyond which a pixel shows soil."""

Array = NDArray[np.float64]


def windy(start_s: float = 0.0, rate_hz: float = RATE_HZ, seed: int = 11) -> Scene:
    """Return the scene from ``start_s`` on, at a frame rate."""
    plain = st.load_scene(FILE).to_dict() | {"seed": seed}
    plain["frames"]["frame_interval_s"] = 1 / rate_hz
    for motion in plain["objects"][0]["motion"]:
        curve = motion["distance_mm"] if motion["kind"] == "shift" else motion["angle_deg"]
        if curve["kind"] == "harmonic":
            curve["phase_deg"] += 360 * start_s * RATE_HZ / curve["period_frames"]
            curve["period_frames"] *= rate_hz / RATE_HZ
        else:
            curve["start"] += curve["rate_per_frame"] * start_s * RATE_HZ
            curve["rate_per_frame"] *= RATE_HZ / rate_hz
    return st.Scene.from_dict(plain)


def tracked(seconds: Array) -> Array:
    """Return the positions of points of the leaf at these times, shape (times, 3, points)."""
    scene = st.load_scene(FILE, overrides=["frames.count=1", "stage.positions=1"])
    truth = st.make_truth(scene).isel(y=slice(None, None, 8), x=slice(None, None, 8))
    points = st.track_points(scene, truth, seconds * RATE_HZ)
    return points[:, :, truth["object_id"].sel(t=0).values == 0]


def scan() -> None:
    """Print the image speed of the leaf, and the depth error due to sway by time per position of a stage."""
    scene, starts = windy(), np.random.default_rng(1).uniform(0, 600, 100)
    f, baseline = scene.camera.focal_px, scene.stage.baseline_mm
    before, after = (f * p[:, :2] / p[:, 2:] for p in (tracked(starts - 0.001), tracked(starts + 0.001)))
    speed = np.hypot(*np.moveaxis(after - before, 1, 0)) / 0.002
    print(f"motion in the image: {rms(speed):.3g} px/s (RMS), {speed.max():.3g} at most")
    print("s per position   error of depth, mm (RMS)   lateral misfit, px (RMS)")
    for pause in (0.3, 0.03, 0.003, 0.0003):
        left, middle, right = (tracked(starts + step * pause) for step in (-1, 0, 1))
        x_left, x_right = f * (left[:, 0] + baseline) / left[:, 2], f * (right[:, 0] - baseline) / right[:, 2]
        depth = f * baseline / ((x_left - x_right) / 2)
        across = f * (right[:, 1] / right[:, 2] - left[:, 1] / left[:, 2]) / 2
        print(f"{pause:<16g} {rms(depth - middle[:, 2]):<26.2g} {rms(across):.2g}")


def rates() -> None:
    """Print the errors of the refined method for a burst, by frame rate."""
    print("frames/s   motion, px/frame   valid   error of depth, mm   error of U_Z, mm/s   (medians)")
    for rate in (100.0, 50.0, 25.0, 12.5, 6.25, 3.125):
        scene = windy(start_s=0.4, rate_hz=rate)
        recording, truth = st.simulate(scene)
        estimate, true = st.estimate(recording, scene.estimate.method, scene.estimate.settings).sel(t=0), truth.sel(t=0)
        leaf = (true["object_id"].values == 0) & (true["boundary_distance"].values > 12)
        off = (estimate["depth"] - true["depth"]).values[leaf]
        fast = (estimate["velocity"] - true["velocity"]).sel(component="Z").values[leaf] * rate
        moved = rms(np.hypot(*true["flow"].values[:, leaf]))
        valid = np.isfinite(fast)
        middle = [np.median(np.abs(values[valid])) if valid.any() else np.nan for values in (off, fast)]
        print(f"{rate:<10g} {moved:<18.2g} {valid.mean():<7.2f} {middle[0]:<20.2g} {middle[1]:.2g}", flush=True)


def periods() -> None:
    """Print the periods determined from twenty seconds of video, at one point of the leaf."""
    from scipy.optimize import least_squares

    seconds = np.arange(0, 20, 1 / RATE_HZ)
    z = tracked(seconds)[:, 2]
    z = z[:, z.shape[1] // 2] + np.random.default_rng(2).normal(0, SHOT_MM, len(seconds))
    power = np.abs(np.fft.rfft((z - z.mean()) * np.hanning(len(z)), 16 * len(z))) ** 2
    hertz = np.fft.rfftfreq(16 * len(z), 1 / RATE_HZ)
    peaks = (
        np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] > power[2:]) & (power[1:-1] > power.max() / 200)) + 1
    )

    def left(given: Array) -> Array:
        terms = design(seconds, 1 / given)
        return np.asarray(z - terms @ np.linalg.lstsq(terms, z, rcond=None)[0])

    found = least_squares(left, hertz[peaks], x_scale=1e-3)
    errors = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * np.mean(found.fun**2))
    for frequency, error in zip(found.x, errors, strict=True):
        print(f"{1 / frequency:.4f} s +- {error / frequency**2:.4f}")
    print(f"residual: {rms(found.fun):.3f} mm")


def design(seconds: Array, periods_s: Array | tuple[float, ...], rate: bool = False) -> Array:
    """Return the design matrix of a straight line in minutes and of harmonics, or its derivative per second."""
    columns = [np.full_like(seconds, not rate), np.full_like(seconds, 1 / 60) if rate else seconds / 60]
    for period in periods_s:
        turn = 2 * np.pi / period
        sine, cosine = np.sin(turn * seconds), np.cos(turn * seconds)
        columns += [turn * cosine, -turn * sine] if rate else [sine, cosine]
    return np.stack(columns, -1)


def plans() -> None:
    """Print the error of the drift for several plans, over points of the leaf and start times."""
    seconds = np.arange(0, 20, 0.1)
    z = tracked(seconds)[:, 2]
    model = design(seconds, ALL_PERIODS_S)
    sway = np.asarray(np.linalg.lstsq(model, z, rcond=None)[0], dtype=np.float64)
    print(f"residual of the harmonics of three periods: {rms(z - model @ sway):.1g} mm")
    sway[:2] = 0.0
    for title, steady in (("steady wind", True), ("wind with a new phase every minute", False)):
        print(f"\n{title}: error of drift, mm/min (RMS)\nminutes  " + "  ".join(PLANS))
        for minutes in (5, 10, 20, 60):
            errors = [tried(sway, minutes, steady, plan) for plan in PLANS.values()]
            print(
                f"{minutes:<8} "
                + "  ".join(f"{error:<{len(name)}.2g}" for name, error in zip(PLANS, errors, strict=True))
            )


@dataclass(frozen=True)
class Plan:
    """Sampling plan, and the fitted model: a straight line, and harmonics."""

    every_s: float = 60.0
    at_random: bool = False
    """Random delay of up to half of the interval."""
    periods_s: tuple[float, ...] = ()
    burst: bool = False
    """Five frames, which also give U_Z."""
    shots: int = 1
    """Number of averaged shots, 0.2 s apart."""


PLANS: Mapping[str, Plan] = {
    "one shot a minute": Plan(),
    "every 63 s": Plan(every_s=63.0),
    "every 62.8 s": Plan(every_s=62.8),
    "at random, harmonics": Plan(at_random=True, periods_s=PERIODS_S),
    "bursts at random, harmonics": Plan(at_random=True, periods_s=PERIODS_S, burst=True),
    "mean of 100 in 20 s": Plan(shots=100),
}


def tried(sway: Array, minutes: float, steady: bool, plan: Plan) -> float:
    """Return the RMSE of the drift for a plan, in mm per minute."""
    generator, errors = np.random.default_rng(3), []
    for _ in range(200):
        begins = np.arange(0, 60 * minutes + 1, plan.every_s)
        begins = begins + (generator.uniform(0, plan.every_s / 2, len(begins)) if plan.at_random else 0.0)
        phase = generator.uniform(0, 600, 1 if steady else len(begins))
        moments = (begins + phase)[:, None] + (np.arange(plan.shots) - (plan.shots - 1) / 2) * 0.2
        point = generator.integers(sway.shape[1])
        at, rate = (design(moments.ravel(), ALL_PERIODS_S, rate) @ sway[:, point] for rate in (False, True))
        z = at.reshape(moments.shape).mean(-1) + DRIFT * begins / 60
        noise = BURST_MM if plan.burst else SHOT_MM / np.sqrt(plan.shots)
        rows, told = [design(begins, plan.periods_s) / noise], [z / noise + generator.normal(size=len(z))]
        if plan.burst:
            rows.append(design(begins, plan.periods_s, rate=True) / BURST_MM_PER_S)
            told.append((rate + DRIFT / 60) / BURST_MM_PER_S + generator.normal(size=len(z)))
        found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(told), rcond=None)[0]
        errors.append(found[1] - DRIFT)
    return rms(np.array(errors))


def bursts() -> None:
    """Simulate eleven bursts in ten minutes, estimate each separately, and print the drift."""
    seconds = 60.0 * np.arange(11) + np.random.default_rng(4).uniform(0, 30, 11)
    depths, speeds = [], []
    for number, start in enumerate(seconds):
        scene = windy(start, seed=100 + number)
        recording, truth = st.simulate(scene)
        estimate = st.estimate(recording, scene.estimate.method, scene.estimate.settings).sel(t=0)
        leaf = (estimate["status"].values == 2) & (estimate["depth"].values < SOIL_MM)
        true = truth.sel(t=0)["object_id"].values == 0
        exact = [float(values[true].mean()) for values in toward(truth.sel(t=0))]
        found = [float(values[leaf].mean()) for values in toward(estimate)]
        depths.append(found[0])
        speeds.append(found[1])
        told = f"{start:5.1f} s: {found[0]:.3f} mm (truth {exact[0]:.3f}), {found[1]:+.2f} mm/s (truth {exact[1]:+.2f})"
        print(told, flush=True)
    fitted("straight line", seconds, np.array(depths))
    fitted("with harmonics", seconds, np.array(depths), np.array(speeds))


def toward(one: xr.Dataset) -> tuple[Array, Array]:
    """Return depth in mm and its change in mm/s."""
    return one["depth"].values, one["velocity"].sel(component="Z").values * RATE_HZ


def fitted(title: str, seconds: Array, depths: Array, speeds: Array | None = None) -> None:
    """Print the drift of a fit and its standard error, from the residuals."""
    weight = BURST_MM / BURST_MM_PER_S
    periods_s = () if speeds is None else PERIODS_S
    rows, told = design(seconds, periods_s), depths
    if speeds is not None:
        rows = np.concatenate([rows, design(seconds, periods_s, rate=True) * weight])
        told = np.concatenate([told, speeds * weight])
    found, *_ = np.linalg.lstsq(rows, told, rcond=None)
    left = told - rows @ found
    error = np.sqrt(np.linalg.inv(rows.T @ rows)[1, 1] * np.sum(left**2) / (len(told) - len(found)))
    print(f"{title}: drift {found[1]:+.3f} +- {error:.3f} mm/min; residual {rms(left[: len(seconds)]):.3f} mm")


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    {"scan": scan, "rates": rates, "periods": periods, "plans": plans, "bursts": bursts}[sys.argv[1]]()
