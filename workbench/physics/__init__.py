"""The physics as terms: one effect per file. A model is a tuple of terms, and nothing is added behind it.

To add an effect, write one file with a frozen :class:`~workbench.physics.term.Term`, give it a closed form or an
independent computation in ``tests/verification``, and put it in the tuple.
"""
