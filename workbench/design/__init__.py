"""Design of a chip: which dimensions matter, what tolerances leave of it, what the best one is.

A figure is a number that a chip is judged by (`workbench.design.figures`). A model (`workbench.design.model`) gives the
figures of one chip in one state, and their exact derivatives, for any lengths, moduli and losses within ranges;
studies, tolerances and optimisation ask nothing else.
"""
