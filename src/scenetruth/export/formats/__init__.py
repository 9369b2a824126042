"""The formats: one module each, with its options, what it needs, and how it is written."""
