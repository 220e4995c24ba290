"""The catalogue of hypotheses about physics that a model lacks."""
