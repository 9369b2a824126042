"""Looks at everything, what takes long side by side."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from scenetruth.cli.doctor.caches import look_at_caches
from scenetruth.cli.doctor.finding import Finding
from scenetruth.cli.doctor.machine import look_at_machine, look_at_python, look_at_terminal
from scenetruth.cli.doctor.packages import look_at_extras, look_at_packages
from scenetruth.cli.doctor.rendering import RENDERERS, look_at_rendering, render_alone

__all__ = ["examine"]


def examine() -> list[Finding]:
    """Return how everything is that scenetruth uses on this machine.

    Returns
    -------
    list of Finding
        Python and packages, rendering, machine, caches, extras, terminal.
    """
    with ThreadPoolExecutor(len(RENDERERS)) as side:
        # In processes of their own, which render while this one loads libraries.
        rendered = {name: side.submit(render_alone, name) for name in RENDERERS}
        first = [*look_at_python(), *look_at_packages()]
        rest = [*look_at_machine(), *look_at_caches(), *look_at_extras(), look_at_terminal()]
        answers = {name: answer.result() for name, answer in rendered.items()}
    return [*first, *look_at_rendering(answers), *rest]
