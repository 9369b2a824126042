"""Resumable jobs: executors, the scheduler of tasks, and results kept by content."""
