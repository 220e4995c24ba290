"""From a measured spectrum to material parameters: the workbench's own fit, and the paper's algorithms beside it."""
