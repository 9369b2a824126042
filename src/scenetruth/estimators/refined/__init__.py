"""Multi-image least-squares matching: one fit of all images to a surface that moves, rotates and grows."""
