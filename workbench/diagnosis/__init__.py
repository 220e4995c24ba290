"""Diagnosis of missing physics from the mismatch between models and recordings."""
