"""The cases of the suite, one module each; those that are here are found by themselves."""
