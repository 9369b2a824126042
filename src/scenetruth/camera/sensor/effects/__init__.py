"""The effects that sensors are made of, one a module; each is found by its kind."""
