"""What waves textures consist of, by their kinds: one module each; what has no formula is painted and measured."""
