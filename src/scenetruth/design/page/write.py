"""Writes the page of a design: one file of HTML that needs no network."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scenetruth.design.optimise.answer.preview import preview_of
from scenetruth.design.optimise.result import Design
from scenetruth.design.optimise.words import order_words
from scenetruth.design.page.answer import reached_of, sensitivity_words, warnings_of
from scenetruth.design.page.charts.front import front_charts
from scenetruth.design.page.charts.sensitivity import sensitivity_charts
from scenetruth.design.page.links import links_in
from scenetruth.design.page.scene_file import plain_yaml, preview_file_of, scene_file_of
from scenetruth.design.page.side_view.draw import drawings_of, words_of
from scenetruth.design.page.side_view.scenery import colours_of
from scenetruth.design.page.side_view.view import side_view_of
from scenetruth.design.page.tables import (
    constraint_table,
    discrepancy_table,
    front_table,
    order_table,
    parameter_table,
    rule_table,
    sensitivity_table,
    tightest_of,
)
from scenetruth.design.page.words import length, number, percent
from scenetruth.pages.rendering import page_of
from scenetruth.placing import write_aside

__all__ = ["PAGE", "blur_limit_of", "write_design_page"]

PAGE = "index.html"
_BLUR_PX = 1.0
"""Blur that counts as sharp where the goal says nothing."""


def write_design_page(design: Design, folder: str | Path) -> Path:
    """Write the page of a design.

    Parameters
    ----------
    design
        The design.
    folder
        Where the page goes. Budget and pattern that lie there already are linked.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    SceneError
        If the scene of the recommended rig cannot be made.
    StoreError
        If the page cannot be written.

    See Also
    --------
    scenetruth.design.optimise.optimise : Makes a design, and with a folder its page.
    scenetruth.Design.load : A design that lies in a folder.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from scenetruth.design.optimise import optimise
    >>> wall = {"name": "wall", "mesh": {"kind": "plane", "size_mm": [200, 200]}, "pose": {"position_mm": [0, 0, 500]}}
    >>> wall |= {"texture": {"kind": "noise", "wavelength_mm": [4, 16]}}
    >>> scene = {"camera": {"width": 64, "height": 48, "focal_length_px": 500}, "objects": [wall]}
    >>> scene |= {"stage": {"positions": 3, "baseline_mm": 4}, "frames": {"count": 3}, "sensor": {"noise_std": 0.01}}
    >>> goal = {"title": "A wall", "scene": scene, "free": {"stage.baseline_mm": {"values": [4, 6, 8, 10]}}}
    >>> goal |= {"constraints": [{"kind": "stage_travel", "at_most": 16}], "objectives": [{"quantity": "depth"}]}
    >>> goal |= {"search": {"predictions": 16, "morris": 0, "sobol": 0}, "confirm": {"rigs": 0}}
    >>> design = optimise(goal, workers=0)
    >>> with TemporaryDirectory() as folder:
    ...     page = write_design_page(design, folder)
    ...     page.name, design.title in page.read_text(encoding="utf-8")
    ('index.html', True)
    """
    view = side_view_of(design.recommended.scene, blur_limit_of(design.goal), design.objectives[0].region)
    on_front, on_parameters = front_charts(design), sensitivity_charts(design)
    charts = {chart.name: {"data": chart.data, "layout": chart.layout} for chart in (*on_front, *on_parameters)}
    tightest = tightest_of(design.recommended)
    text = page_of(
        "scenetruth.design.page",
        "design.html.j2",
        charts,
        design=design,
        rig=design.recommended,
        reached=reached_of(design),
        warnings=warnings_of(design),
        tightest=tightest,
        left=percent(tightest.margin) if tightest is not None else "",
        view=view,
        drawings=drawings_of(view),
        drawn=words_of(view),
        outlines=list(zip(view.outlines, colours_of(view), strict=True)),
        parameters=parameter_table(design),
        file=scene_file_of(design.recommended, "recommended.yaml"),
        preview=preview_file_of(design),
        preview_changes=preview_of(design).changes,
        front=front_table(design),
        front_charts=on_front,
        constraints=constraint_table(design.recommended),
        sensitivity_charts=on_parameters,
        sensitivities=sensitivity_table(design),
        sensitivity_words=sensitivity_words(design),
        rules=rule_table(design),
        discrepancies=discrepancy_table(design),
        orders=order_table(design),
        order_words=list(order_words(design.objectives, design.orders)),
        goal=plain_yaml(design.goal),
        links=links_in(folder),
        number=number,
        length=length,
    )
    path = Path(folder) / PAGE
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
    return path


def blur_limit_of(goal: Mapping[str, Any]) -> float:
    """Return the diameter in px of the blur disc that a goal lets pass as sharp; 1 px if it says nothing.

    Parameters
    ----------
    goal
        The goal as plain values.
    """
    limits = []
    for one in goal.get("constraints") or ():
        if one.get("kind") == "depth_of_field":
            limits.append(float(one.get("blur_px") or _BLUR_PX))
        elif one.get("kind") == "defocus_blur" and one.get("at_most"):
            limits.append(float(one["at_most"]))
    return min(limits, default=_BLUR_PX)
