"""Leaves: their outline, mesh, veins and texture."""
