"""Measurements of speed and accuracy, and the programs that write the results pages."""
