"""Leaves: their margin, form and mesh, and what is seen on them."""
