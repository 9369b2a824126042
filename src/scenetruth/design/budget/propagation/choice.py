"""Which model propagates errors for a method."""

from __future__ import annotations

from scenetruth.design.budget.propagation.base import Propagation
from scenetruth.design.budget.propagation.refined import RefinedPropagation
from scenetruth.design.budget.propagation.structure_tensor import TensorPropagation
from scenetruth.design.budget.sight import Sight
from scenetruth.estimators.refined.settings import RefinedSettings
from scenetruth.estimators.structure_tensor.settings import StructureTensorSettings
from scenetruth.model import FrozenModel

__all__ = ["MODELLED", "propagation_of"]

MODELLED = ("structure_tensor", "refined")
"""Methods whose errors can be predicted; of others, all is simulated."""


def propagation_of(sight: Sight, settings: FrozenModel) -> Propagation | None:
    """Return the model of a method, by its settings; None if there is none."""
    if isinstance(settings, StructureTensorSettings):
        return TensorPropagation(sight, settings)
    if isinstance(settings, RefinedSettings) and len(sight.s) > 1:
        return RefinedPropagation(sight, settings)
    return None
