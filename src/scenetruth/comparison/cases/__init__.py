"""The cases of the suite, one module each, in rooms; those that are here are found by themselves."""
