"""The refined estimator: one least-squares fit of all images to a surface that moves, turns and grows."""
