"""What a recipe would make, seen before anything is made."""
