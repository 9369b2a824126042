"""The page of a design: the rig drawn to scale, its scene file, the alternatives, and what stands behind them."""
