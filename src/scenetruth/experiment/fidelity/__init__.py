"""The fidelity of the renderers to the exact pixel integral."""
