"""A rig from the values of what is free: its scene, its prediction, its constraints."""
