"""The physics as terms: one effect per file.

A model is a tuple of terms and nothing else. To add an effect, write one file with a frozen
:class:`~workbench.physics.term.Term`, verify it in ``tests/verification`` against a closed form or an independent
computation, and put it in the tuple.
"""
