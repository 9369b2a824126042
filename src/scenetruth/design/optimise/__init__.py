"""Which rig to build: goals, catalogues, constraints, the search for the best, and its confirmation by simulation."""

from scenetruth.design.optimise.goal.load import goal_from_plain, load_goal
from scenetruth.design.optimise.goal.spec import Goal
from scenetruth.design.optimise.result import Design
from scenetruth.design.optimise.run import optimise

__all__ = ["Design", "Goal", "goal_from_plain", "load_goal", "optimise"]
