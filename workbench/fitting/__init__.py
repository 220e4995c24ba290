"""Fits of material parameters to measured spectra."""
