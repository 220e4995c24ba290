"""A chip and its materials as one problem with mesh and parameters."""
