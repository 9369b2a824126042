"""The cases of the benchmark suite."""
