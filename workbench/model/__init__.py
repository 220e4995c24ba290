"""A chip and its materials as one problem, the mesh it is solved on, and the numbers it depends on."""
