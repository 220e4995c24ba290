"""The catalogue of hypotheses: the physics that a model may have left out, each with its terms and numbers."""
