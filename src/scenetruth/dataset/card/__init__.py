"""What a data set is, told to people and to machines: the card and its metadata."""
