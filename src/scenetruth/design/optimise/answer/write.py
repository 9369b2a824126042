"""The files of a design: tables, the scene that is ready to run, the answer as plain values, the page."""

from __future__ import annotations

import json
from pathlib import Path

import yaml

from scenetruth.design.optimise.answer.plain import plain_of
from scenetruth.design.optimise.answer.preview import PREVIEW, preview_of
from scenetruth.design.optimise.answer.screened import write_screened
from scenetruth.design.optimise.result import ANSWER, SCREENED, Design
from scenetruth.placing import write_aside

__all__ = ["FRONT", "RIG", "write_design"]

FRONT, RIG = "front.csv", "recommended.yaml"


def write_design(design: Design, folder: Path) -> None:
    """Write a design: ``recommended.yaml`` and its preview, tables, ``design.json``, ``index.html``.

    Parameters
    ----------
    design
        The design.
    folder
        Its folder, which exists.
    """
    head = f"# {design.title}: the recommended rig, ready to run: scenetruth run {RIG} -o results\n"
    text = head + yaml.safe_dump(plain_of(design.recommended.scene), sort_keys=False, allow_unicode=True)
    _put(folder / RIG, text)
    light = preview_of(design)
    head = f"# {design.title}: a part of what the recommended rig sees: scenetruth run {PREVIEW} -o preview\n"
    head += f"# Beside {RIG}: {'; '.join(light.changes) or 'nothing is left out'}\n"
    _put(folder / PREVIEW, head + yaml.safe_dump(plain_of(light.plain), sort_keys=False, allow_unicode=True))
    with write_aside(folder / FRONT, overwrite=True) as aside:
        design.to_frame().to_csv(aside, index=False)
    with write_aside(folder / SCREENED, overwrite=True) as aside:
        write_screened(design.screened, aside)
    _put(folder / ANSWER, json.dumps(design.to_plain(), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    from scenetruth.design.page.write import write_design_page

    write_design_page(design, folder)


def _put(path: Path, text: str) -> None:
    with write_aside(path, overwrite=True) as aside:
        aside.write_text(text, encoding="utf-8")
