"""The checks: one module each, whose docstring says what it demands; see `registry`."""
