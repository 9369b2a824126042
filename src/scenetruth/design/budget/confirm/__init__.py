"""Causes that are simulated: runs of the scene with some causes on, and the errors that they leave."""
