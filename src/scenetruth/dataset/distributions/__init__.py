"""What a varied field of a scene may be: one module per kind."""
