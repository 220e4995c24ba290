"""Fits of material parameters to measured spectra: the workbench's own, and the paper's algorithms."""
