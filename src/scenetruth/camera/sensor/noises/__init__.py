"""The noises and patterns of sensors, one a module; each is found by its kind."""
