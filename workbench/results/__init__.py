"""Spectra, figures of merit, circuits and comparisons, with short texts."""
