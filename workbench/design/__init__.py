"""Design of a chip: the dimensions that matter, its yield under tolerances, and the best chip for a goal.

A figure is a number that a chip is judged by (`workbench.design.figures`). A model (`workbench.design.model`) gives the
figures of one chip in one state, and their exact derivatives, for any lengths, moduli and losses within ranges;
studies, tolerances and optimisation ask nothing else.
"""
