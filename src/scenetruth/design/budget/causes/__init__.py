"""Causes of errors, one module each."""
