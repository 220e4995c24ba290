"""Results a person reads: spectra, figures of merit, comparisons, and their short texts."""
