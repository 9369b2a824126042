"""Textures whose motion is ambiguous, textures finer than the pixels, and controls in which all is well."""

from __future__ import annotations

from benchmarks.trust import PIXEL_MM, Plain, noise, plane, rig

__all__ = ["GROUPS", "SCENES"]

ENDLESS_MM = 1e6


def turned(texture: Plain, angle_deg: float) -> Plain:
    """Return a scene of a sheet that is turned in the image."""
    rotations = [{"axis": [0, 0, 1], "angle_deg": angle_deg}, {"axis": [0, 1, 0], "angle_deg": 10}]
    mesh = {"kind": "plane", "size_mm": [150, 150]}
    return rig([plane(texture, mesh=mesh, pose={"position_mm": [0, 0, 600], "rotations": rotations})])


def stripes(wave_px: float, angle_deg: float) -> Plain:
    """Return a scene of cosine stripes; at 0 degrees they run along y."""
    waves = [wave_px * PIXEL_MM, ENDLESS_MM]
    return turned({"kind": "plaid", "wavelength_mm": waves, "mean": 0.5, "amplitude": 0.3}, angle_deg)


def plaid(wave_px: float, angle_deg: float) -> Plain:
    """Return a scene of crossed cosine waves."""
    waves = [wave_px * PIXEL_MM, 1.3 * wave_px * PIXEL_MM]
    return turned({"kind": "plaid", "wavelength_mm": waves, "mean": 0.5, "amplitude": 0.3}, angle_deg)


def checkers(square_px: float, angle_deg: float) -> Plain:
    """Return a scene of a checkerboard."""
    return turned({"kind": "checkerboard", "square_mm": square_px * PIXEL_MM, "radiances": [0.3, 0.7]}, angle_deg)


SCENES: dict[str, Plain] = {
    **{
        f"stripes {wave:g} px {angle:g} deg": stripes(wave, angle)
        for wave, angle in (
            (9, 0),
            (14, 0),
            (11, 5),
            (9, 10),
            (14, 30),
            (9, 45),
            (9, 60),
            (14, 90),
            (12, 75),
            (20, 10),
            (7, 90),
            (10, 20),
        )
    },
    **{
        f"checkers {square:g} px {angle:g} deg": checkers(square, angle)
        for square, angle in ((4, 0), (9.5, 0), (6.5, 0), (13, 0), (20, 0), (5, 20), (9.5, 30), (13, 10), (16, 0))
    },
    **{
        f"plaid {wave:g} px {angle:g} deg": plaid(wave, angle)
        for wave, angle in ((9, 0), (16, 0), (12, 0), (9, 30), (20, 15), (12, 45))
    },
    **{
        f"control {name}": scene
        for name, scene in {
            "noise 4 to 20 px": rig([plane(noise(4, 20))]),
            "noise 4 to 40 px": rig([plane(noise(4, 40))]),
            "noise 6 to 12 px": rig([plane(noise(6, 12))]),
            "noise 8 to 60 px": rig([plane(noise(8, 60))]),
            "noise 4 to 20 px, weak": rig([plane(noise(4, 20, 0.06))]),
            "noise 4 to 20 px, 5 % noise": rig([plane(noise(4, 20))], sensor={"noise_std": 0.05}),
            "noise 5 to 30 px, 3 % noise": rig([plane(noise(5, 30))], sensor={"noise_std": 0.03}),
            "noise 10 to 20 px": rig([plane(noise(10, 20))]),
            "noise 5 to 10 px": rig([plane(noise(5, 10, 0.15))], seed=5),
        }.items()
    },
    **{
        f"fine noise {shortest:g} to {longest:g} px": rig([plane(noise(shortest, longest))])
        for shortest, longest in ((2, 3), (2.2, 2.8), (2, 2.5), (2.5, 3.5), (2, 6), (2.3, 3), (1.6, 3), (3, 4), (2, 4))
    },
}

GROUPS: dict[str, str] = {
    "stripes": r"stripes",
    "plaids": r"plaid",
    "checkerboards of 4 to 16 px": r"checkers (4|9|13|16)",
    "checkerboards of 20 px": r"checkers 20",
    "textures of 2 to 4 px": r"fine noise",
    "controls: noise textures": r"control",
}
"""Rows of the summary, and what the names of their scenes contain."""
