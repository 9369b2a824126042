"""Data sets: many scenes from one recipe, drawn, simulated, catalogued and read."""
