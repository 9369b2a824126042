"""The figures that were measured before, and the work that each is made again with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

__all__ = ["JOBS", "WANTED", "Job", "Wanted"]


@dataclass(frozen=True)
class Job:
    """One run of one program, or, for the star, two.

    Parameters
    ----------
    peer
        One of the peers, or a method of scenetruth.
    scene, pair
        Which images, by the labels of `benchmarks.peers.pairs`.
    options
        What the program is told; of a method, its settings as NAME=VALUE.
    """

    peer: str
    scene: str
    pair: str
    options: tuple[str, ...] = ()


@dataclass(frozen=True)
class Wanted:
    """A figure that was measured before.

    Parameters
    ----------
    job
        Name of its work.
    quantity, statistic
        What it is.
    number
        What was found; None if nothing was, and the figure is only told.
    """

    job: str
    quantity: str
    statistic: str
    number: float | None


_SUBSET = ("--subset", "25")
JOBS: dict[str, Job] = {
    "pyvale: cube": Job("pyvale", "cube", "near"),
    "pyvale_stereo: cube": Job("pyvale_stereo", "cube", "far"),
    "al_dic_3d: cube": Job("al_dic_3d", "cube", "far"),
    "sun_dic: cube": Job("sun_dic", "cube", "near"),
    "pyxel: cube": Job("pyxel", "cube", "near", ("--rectangle",)),
    "mudic: cube": Job("mudic", "cube", "near"),
    "farneback: cube": Job("opencv", "cube", "near", ("flow=farneback",)),
    "dis: cube": Job("opencv", "cube", "near", ("flow=dis",)),
    "pyvale: cube_ideal": Job("pyvale", "cube_ideal", "near"),
    "pyvale_stereo: cube_ideal": Job("pyvale_stereo", "cube_ideal", "far"),
    "pyvale_stereo: leaf": Job("pyvale_stereo", "leaf", "far"),
    "al_dic_3d: leaf": Job("al_dic_3d", "leaf", "far"),
    "pyvale_stereo 75 px: leaf": Job("pyvale_stereo", "leaf", "far", ("--growth", "15")),
    "pyvale_stereo 45 px: leaf": Job("pyvale_stereo", "leaf", "far", ("--growth", "9")),
    "al_dic_3d 33 px: leaf": Job("al_dic_3d", "leaf", "far", ("--growth", "5")),
    "pyvale affine: star": Job("pyvale", "star", "one", _SUBSET),
    "pyvale quadratic: star": Job("pyvale", "star", "one", (*_SUBSET, "--shape", "QUAD")),
    "sun_dic: star": Job("sun_dic", "star", "one", _SUBSET),
    "farneback: star": Job("opencv", "star", "one", ("flow=farneback",)),
    "dis: star": Job("opencv", "star", "one", ("flow=dis",)),
    "structure_tensor: cube": Job("structure_tensor", "cube", "far"),
    "refined: cube": Job("refined", "cube", "far", ("window_sigma_px=8",)),
    "refined 10 px: cube": Job("refined", "cube", "far", ("window_sigma_px=10",)),
    "refined rigid: cube": Job("refined", "cube", "far", ("window_sigma_px=8", "motion=rigid")),
    "refined: leaf": Job("refined", "leaf", "far", ("window_sigma_px=8",)),
    "refined: leaf_anisotropic": Job("refined", "leaf_anisotropic", "far", ("window_sigma_px=8",)),
}
"""All work, by name; that of scenetruth is done with the four images that stereo correlation sees."""


def _rows() -> Iterator[Wanted]:
    both = ("rmse", "median_abs_error")
    told: dict[tuple[str, str], tuple[float | None, ...]] = {
        ("pyvale: cube", "flow"): (0.0113, 0.0089),
        ("pyvale: cube", "disparity"): (0.0078, 0.0048),
        ("pyvale_stereo: cube", "depth"): (0.031, 0.022),
        ("pyvale_stereo: cube", "velocity_z"): (0.043, 0.027),
        ("al_dic_3d: cube", "depth"): (0.031, 0.021),
        ("al_dic_3d: cube", "velocity_z"): (0.067, 0.046, -0.045),
        ("sun_dic: cube", "flow"): (0.0118, 0.0091),
        ("sun_dic: cube", "disparity"): (0.0074, 0.0045),
        ("pyxel: cube", "flow"): (0.023,),
        ("pyxel: cube", "disparity"): (0.014,),
        ("mudic: cube", "flow"): (0.022,),
        ("mudic: cube", "disparity"): (0.014,),
        ("farneback: cube", "flow"): (0.031,),
        ("farneback: cube", "disparity"): (0.023,),
        ("dis: cube", "flow"): (0.074,),
        ("dis: cube", "disparity"): (0.057,),
        ("pyvale: cube_ideal", "flow"): (0.0015,),
        ("pyvale: cube_ideal", "disparity"): (0.0008,),
        ("pyvale_stereo: cube_ideal", "depth"): (0.007,),
        ("pyvale_stereo: cube_ideal", "velocity_z"): (0.006,),
        ("pyvale_stereo: leaf", "depth"): (0.049, 0.032),
        ("pyvale_stereo: leaf", "velocity_z"): (0.058, 0.038),
        ("al_dic_3d: leaf", "depth"): (0.134, 0.120),
        ("al_dic_3d: leaf", "velocity_z"): (0.045, 0.027),
        ("pyvale_stereo 75 px: leaf", "growth_rate"): (0.59, 0.16),
        ("pyvale_stereo 45 px: leaf", "growth_rate"): (0.82, 0.26),
        ("al_dic_3d 33 px: leaf", "growth_rate"): (1.19, 0.47),
        ("structure_tensor: cube", "depth"): (None, None),
        ("structure_tensor: cube", "velocity_z"): (None, None),
        ("refined: cube", "depth"): (None, None),
        ("refined: cube", "velocity_z"): (None, None),
        ("refined 10 px: cube", "depth"): (None, None),
        ("refined 10 px: cube", "velocity_z"): (None, None),
        ("refined rigid: cube", "depth"): (None, None),
        ("refined rigid: cube", "velocity_z"): (None, None),
        ("refined: leaf", "depth"): (None, None),
        ("refined: leaf", "velocity_z"): (None, None),
        ("refined: leaf", "growth_rate"): (None, None),
        ("refined: leaf_anisotropic", "depth"): (None, None),
        ("refined: leaf_anisotropic", "velocity_z"): (None, None),
        ("refined: leaf_anisotropic", "growth_rate"): (None, None),
    }
    for (job, quantity), numbers in told.items():
        for statistic, number in zip((*both, "bias"), numbers, strict=False):
            yield Wanted(job, quantity, statistic, number)
    resolved = {
        "pyvale affine: star": (107, 0.00146),
        "pyvale quadratic: star": (45, 0.00278),
        "sun_dic: star": (105, 0.00151),
        "farneback: star": (54, 0.0042),
        "dis: star": (70, 0.0056),
    }
    for job, (period, noise) in resolved.items():
        yield Wanted(job, "flow_y", "cutoff_period_first", period)
        yield Wanted(job, "flow_y", "noise_std", noise)


WANTED = tuple(_rows())
"""All figures, in the order of the table: px, mm, px or mm per frame, % per hour."""
