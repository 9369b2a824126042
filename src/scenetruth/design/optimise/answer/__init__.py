"""What is told of a design besides figures: what limits, rules of thumb, assumptions; and its files."""
