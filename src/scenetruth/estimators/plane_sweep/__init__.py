"""Disparity of every pixel by trying planes: all cameras of a frame, semi-globally; and motion by random search."""
