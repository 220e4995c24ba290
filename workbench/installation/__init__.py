"""Checks of the installation. They load the interpreter's modules only, so that they work without the libraries."""
