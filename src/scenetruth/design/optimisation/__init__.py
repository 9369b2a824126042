"""Optimisation of a rig: specification, catalogues, constraints, search, and confirmation by simulation."""

from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.optimisation.optimiser import optimise
from scenetruth.design.optimisation.specification import DesignSpec, load_design_spec

__all__ = ["DesignResult", "DesignSpec", "load_design_spec", "optimise"]
