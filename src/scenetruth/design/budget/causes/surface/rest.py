"""What else ideal images leave."""

from __future__ import annotations

from scenetruth.design.budget.surface_cause import SurfaceCause


class Rest(SurfaceCause):
    """The method's own bias: filters that are not exact, interpolation, texture finer than the pixels."""

    kind = "rest"
    title = "the method's own bias"
