"""What a rig must satisfy: one module per constraint, found by itself."""
