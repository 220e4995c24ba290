"""Reduced models: the same system on a small basis of its own solutions."""
