"""The report of a design: the rig drawn to scale, its scene file, alternatives, sensitivities and tables."""
