"""The catalogue of a data set: one row per sample, and what is told of all of them."""
