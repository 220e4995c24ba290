"""From a mismatch between model and recordings to the physics left out."""
