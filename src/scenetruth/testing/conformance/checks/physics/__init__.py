"""What must hold for any method, because it holds for cameras and surfaces."""
