"""What several tests share: scenes, sensors, independent readings of methods and formats."""
