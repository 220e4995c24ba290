"""Parallel work, its interruption, and the memory that it may take."""
