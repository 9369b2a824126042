"""Many scenes from one recipe: drawn, made, catalogued and read."""
