"""What constraints on the capture measure: times, light, motion, data."""
