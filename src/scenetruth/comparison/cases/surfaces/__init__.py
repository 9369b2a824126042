"""Cases that vary what is seen: slopes, curvature, outlines, waves, growth."""
