"""What a method must take, or refuse as methods do."""
