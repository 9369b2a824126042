"""What a design takes for granted, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from scenetruth.design.optimise.constraints.facts import Facts
from scenetruth.design.optimise.goal.spec import Goal
from scenetruth.design.optimise.parts import Sensitivity

__all__ = ["assumptions_of"]


def assumptions_of(
    goal: Goal, facts: Facts, changes: Sequence[str], left_out: tuple[float, float], effects: Sequence[Sensitivity]
) -> tuple[str, ...]:
    """Return what is taken for granted.

    Parameters
    ----------
    goal
        The goal.
    facts
        The recommended rig.
    changes
        What is different in simulations, in words.
    left_out
        Shares of trajectories and base samples that sensitivity leaves out.
    effects
        What parameters do.
    """
    return tuple(_lines(goal, facts, changes, left_out, effects))


def _lines(
    goal: Goal, facts: Facts, changes: Sequence[str], left_out: tuple[float, float], effects: Sequence[Sensitivity]
) -> Iterator[str]:
    yield (
        "predictions are standard deviations of noise (Cramér-Rao bound of the method's window and motion, from "
        "geometry and the texture's spectrum), with the stage's errors and its time in closed form; the method's own "
        "bias, curved surfaces and edges are not in them, and show in the simulations"
    )
    yield from facts.prediction.notes
    if facts.lens is not None:
        yield (
            "the lens is a thin one, focused where the first objective's region is; its blur and diffraction are one "
            "Gaussian; it is calibrated"
        )
        residual_px = facts.lens.distortion_residual_um / (facts.scene.camera.pixel_pitch_um or 1.0)
        if residual_px > 0:
            off = facts.depth_mm * residual_px / max(abs(facts.causes.disparity_px), 1e-9)
            yield (
                f"what calibration leaves of distortion is not in any figure: {residual_px:.2g} px here, up to "
                f"{off:.2g} mm of depth from place to place"
            )
    if facts.camera is not None and goal.light is None:
        yield "there is as much light as the camera needs: a white surface fills 80 % of what the sensor can say"
    if goal.light is not None:
        yield f"a white surface has {goal.light.illuminance_lux:g} lux, all of it at {goal.light.wavelength_um:g} µm"
    chosen = {"lens": facts.lens, "camera": facts.camera, "stage": facts.stage}
    typical = [name for name, one in chosen.items() if one is not None and "typical" in one.source]
    if typical:
        yield f"figures of the chosen {', '.join(typical)} are at least in part typical of the class; see the catalogue"
    if "frames.frame_interval_s" in goal.free and _has_rates(facts.scene.to_plain()):
        yield "motions that the scene gives per frame are the same per frame at any interval; give them per hour if not"
    yield from (f"in the simulations: {change}" for change in changes)
    for name, share in zip(("Morris", "Sobol'"), left_out, strict=True):
        if share > 0:
            yield f"sensitivity by {name} leaves out {100 * share:.0f} % of its samples, with rigs that cannot be made"
    by_name: dict[str, list[Sensitivity]] = {}
    for one in effects:
        by_name.setdefault(one.parameter, []).append(one)
    idle = [name for name, told in by_name.items() if all(one.morris_mu_star == 0.0 for one in told)]
    if idle:
        yield f"no effect on any objective: {', '.join(idle)}; constraints or chance choose their values"


def _has_rates(plain: Any) -> bool:
    """Whether something in a scene moves by so much per frame."""
    if isinstance(plain, Mapping):
        return any(("per_frame" in str(key) and _some(value)) or _has_rates(value) for key, value in plain.items())
    return isinstance(plain, list | tuple) and any(map(_has_rates, plain))


def _some(value: Any) -> bool:
    values = value if isinstance(value, list | tuple) else [value]
    return any(isinstance(one, int | float) and one != 0 for one in values)
