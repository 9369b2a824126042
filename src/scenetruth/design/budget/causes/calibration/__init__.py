"""Causes in what an estimate is told of its camera."""
