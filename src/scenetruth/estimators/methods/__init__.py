"""The built-in methods: one module each, named like the method, with the object ``METHOD``."""
