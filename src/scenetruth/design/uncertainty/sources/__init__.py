"""Sources of uncertainty, one module per group."""
