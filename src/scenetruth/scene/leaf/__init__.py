"""Leaves: outline, mesh, veins and texture."""
