"""What a recipe of a data set may say, and where it is read."""
