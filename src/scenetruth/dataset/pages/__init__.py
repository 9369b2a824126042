"""Pages on recipes and data sets: card, preview, Croissant metadata, and their templates."""
