"""Measure whether the parts of error budgets add up to what a simulation of everything shows, and what each part is.

Run it from the top of the repository: ``python -m benchmarks.budgets [NAME ...]``. Jobs are called SCENE.SETUP, as
``cube.laboratory``: 320 x 240 pixels from the middle of the library's scenes, the structure tensor, interior. The jobs
called ``effect.NAME`` have the whole cube with one effect of `benchmarks.imperfections`. Runs stay in ``--folder``, and
are not made again. Options of all benchmarks: `benchmarks.jobs`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.beside import scene_of
from benchmarks.imperfections import EFFECTS, IDEAL
from benchmarks.jobs import arguments, ends, heading, line, number
from scenetruth.design.uncertainty import budget

QUANTITIES = ("depth", "velocity_x", "velocity_z", "growth_rate")
SMALL = ["camera.width=320", "camera.height=240", "render.backend=raycast", "render.supersampling=2"]
LABORATORY = [
    "stage.errors={preset: air_bearing}",
    "stage.time_per_position_s=0.01",
    "camera.distortion={k1: -0.2}",
    "optics.vignetting={coefficients: [-0.1, 0, 0]}",
    "lighting.drift_per_frame=0.001",
]
SETUPS: Mapping[str, tuple[list[str], str]] = {
    "shipped": ([], "perfect"),
    "calibrated": ([], "typical"),
    "laboratory": (LABORATORY, "perfect"),
    "screw": (["stage.errors={preset: screw_stage}"], "perfect"),
}
"""Changes of the scene, and how well its calibration is known."""
DRAWS = 4
IMAGING = Path(__file__).parents[1] / "docs" / "results" / "imperfections.md"
MEASURED = {
    "Gaussian noise 1 %, 8 bit": "noise",
    "point spread, Gaussian, 0.7 px": "lens_blur",
    "vignetting, cos⁴ and 20 % in the corners": "vignetting",
    "distortion, 1 px in the corners": "lens_residual",
    "screw stage": "stage_yaw",
    "0.1 frame per position": "timing",
    "brightness drifting 1 % per frame": "brightness",
}
"""Effects of the table of imperfections, and the cause that each is."""


def rows(name: str, setup: str, changes: Sequence[str], folder: str) -> dict[str, Any]:
    """Make a budget, and return its sums and parts."""
    more, calibration = SETUPS[setup]
    found = budget(
        scene_of(name, [*SMALL, *more, *changes]),
        output=Path(folder) / f"{name}.{setup}",
        calibration=calibration,  # type: ignore[arg-type]
        draws=DRAWS,
    )
    return _told(found)


def effect(name: str, changes: Sequence[str], folder: str) -> dict[str, Any]:
    """Make the budget of the whole cube with one effect, by one draw."""
    scene = scene_of("cube", [*IDEAL, *EFFECTS[name], "render.supersampling=2", *changes])
    place = Path(folder) / re.sub(r"\W+", "_", f"effect.{name}")
    return _told(budget(scene, output=place, calibration="perfect", seeds=1, simulated_share=1.0))


def _told(found: Any) -> dict[str, Any]:
    totals = {
        one.quantity: [one.root_sum_square, one.signed_sum, one.simulated, one.ideal]
        for one in found.totals
        if one.region == "interior"
    }
    parts = [
        [one.cause, one.quantity, one.predicted, one.predicted_for_seeds, one.simulated, one.value]
        for one in found.parts
        if one.region == "interior"
    ]
    return {"totals": totals, "parts": parts, "words": found.summary().splitlines()}


def measured(name: str, column: str) -> float:
    """Return what the page on imperfections has measured of an effect with the structure tensor, without the rest."""
    titles, values = (), {}
    for text in IMAGING.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in text.strip("|").split("|")]
        if cells[0] == "effect, alone":
            titles = cells
        if len(cells) > 2 and cells[1] == "structure tensor":
            values[cells[0]] = dict(zip(titles, cells, strict=False))
    with_it, without = (float(values[one][column]) for one in (name, "none"))
    return float(max(with_it**2 - without**2, 0.0) ** 0.5)


def main() -> None:
    """Print the tables: sums beside simulations, then parts."""
    parser = arguments(__doc__)
    parser.add_argument("--folder", default="outputs/budgets", help="where runs are kept")
    given = parser.parse_args()
    scenes = {
        f"{name}.{setup}": (name, setup, given.set, given.folder)
        for name in ("cube", "leaf", "plane")
        for setup in SETUPS
    }
    found = dict(ends(rows, scenes, given))
    print(
        heading(
            ("scene", "quantity", "root of squares", "added up", "everything on", "ratios", "ideal", "largest parts")
        )
    )
    for name, told in found.items():
        for quantity in QUANTITIES:
            if quantity not in told["totals"]:
                continue
            parts, added, simulated, ideal = told["totals"][quantity]
            largest = sorted((one for one in told["parts"] if one[1] == quantity and one[5] == one[5]), key=_figure)
            words = ", ".join(f"{one[0]} {number(one[5])}" for one in largest[:3])
            ratios = f"{parts / simulated:.2f}, {added / simulated:.2f}"
            cells = (number(parts), number(added), number(simulated), ratios, number(ideal), words)
            print(line((name, quantity, *cells)), flush=True)
    print()
    print(heading(("scene", "cause", "quantity", "predicted", "predicted, drawn", "simulated")))
    for name, told in found.items():
        for cause, quantity, predicted, drawn, simulated, _ in told["parts"]:
            if quantity in QUANTITIES and simulated == simulated:
                print(line((name, cause, quantity, *map(_spelled, (predicted, drawn, simulated)))))
    effects = {f"effect.{name}": (name, given.set, given.folder) for name in MEASURED}
    print()
    print(heading(("effect, alone", "quantity", "measured", "simulated", "predicted, drawn", "predicted")))
    for name, told in ends(effect, effects, given):
        plain = name.removeprefix("effect.")
        for quantity, column in (("depth", "depth mm"), ("velocity_z", "U_Z")):
            if plain == "screw stage":
                squares = [[one[k] ** 2 for k in (4, 3, 2)] for one in told["parts"] if one[1] == quantity]
                values = [sum(s[k] for s in squares if s[k] == s[k]) ** 0.5 for k in range(3)]
            else:
                part = next(one for one in told["parts"] if one[:2] == [MEASURED[plain], quantity])
                values = [part[4], part[3], part[2]]
            print(line((plain, quantity, number(measured(plain, column)), *map(_spelled, values))), flush=True)


def _spelled(value: float) -> str:
    return number(value if value == value else None)


def _figure(part: Sequence[Any]) -> float:
    return -float(part[5])


if __name__ == "__main__":
    main()
