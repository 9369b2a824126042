"""The files of a design: tables, the scene that is ready to run, the answer as plain values, the page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from scenetruth.design.optimise.result import Design
from scenetruth.placing import write_aside

__all__ = ["ANSWER", "RIG", "write_design"]

ANSWER, RIG = "design.json", "recommended.yaml"


def write_design(design: Design, folder: Path) -> None:
    """Write a design: ``recommended.yaml``, ``front.csv``, ``screened.csv``, ``design.json``, ``index.html``.

    Parameters
    ----------
    design
        The design.
    folder
        Its folder, which exists.
    """
    head = f"# {design.title}: the recommended rig, ready to run: scenetruth run {RIG} -o results\n"
    text = head + yaml.safe_dump(_plain(design.recommended.scene), sort_keys=False, allow_unicode=True)
    _put(folder / RIG, text)
    for name, frame in (("front.csv", design.to_frame()), ("screened.csv", design.screened)):
        with write_aside(folder / name, overwrite=True) as aside:
            frame.to_csv(aside, index=False)
    told = {
        "format": 1,
        "title": design.title,
        "goal": design.goal,
        "objectives": [asdict(one) for one in design.objectives],
        "recommended": design.recommended.number,
        "front": [asdict(one) for one in design.front],
        "sensitivities": [asdict(one) for one in design.sensitivities],
        "rules": [asdict(one) for one in design.rules],
        "assumptions": design.assumptions,
        "discrepancies": [asdict(one) for one in design.discrepancies],
        "seconds": design.seconds,
        "words": design.words(),
    }
    _put(folder / ANSWER, json.dumps(_plain(told), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    from scenetruth.design.page.write import write_design_page

    write_design_page(design, folder)


def _put(path: Path, text: str) -> None:
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    """Return plain values: numbers that are not finite are null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
