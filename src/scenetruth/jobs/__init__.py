"""Resumable jobs: executors, a scheduler of tasks, and results identified by content."""
