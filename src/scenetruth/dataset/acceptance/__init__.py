"""What the geometry of a draw must satisfy before anything of it is rendered: one module per bound."""
