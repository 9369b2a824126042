"""Optimisation of a rig: specification, catalogues, constraints, search, and confirmation by simulation."""

from scenetruth.design.optimisation.design_result import DesignResult
from scenetruth.design.optimisation.optimiser import optimise
from scenetruth.design.optimisation.specification import DesignSpec, design_spec_from_dict, load_design_spec

__all__ = ["DesignResult", "DesignSpec", "design_spec_from_dict", "load_design_spec", "optimise"]
