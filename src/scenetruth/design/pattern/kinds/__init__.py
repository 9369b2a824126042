"""Patterns: every kind is a module that holds its model and how it is drawn."""
