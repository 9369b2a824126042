"""A scene file to start from: every block with what it means, its units, and what to change first."""
