"""How true the renderers are to the exact pixel integral."""
