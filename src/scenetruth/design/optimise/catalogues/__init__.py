"""Catalogues of lenses, cameras and stages: what ships, and files of one's own."""
