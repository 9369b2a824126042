"""Goal files: what is free, what is demanded, what is to be known precisely."""
