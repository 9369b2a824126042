"""How precise methods of estimation are by theory: one module each, which is found by itself."""
