"""Finite elements: terms become matrices, matrices become solutions."""
