"""Reduced models: the system projected on a small basis of solutions."""
