"""Built-in methods: one module each, named after the method, with the object ``METHOD``."""
