"""A rig seen along Y: where cameras and objects stand, what is seen and what is sharp, and its drawing to scale."""
