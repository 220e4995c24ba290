"""Diagnosis: the physics left out of a model, from its mismatch with recordings."""
