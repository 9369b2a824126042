"""What a method must do whatever its images show."""
