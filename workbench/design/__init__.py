"""Design of a chip: sensitivities, yield under tolerances, and optimisation.

A figure is a number that a chip is judged by (`workbench.design.figures`). A model (`workbench.design.model`) gives the
figures of one chip in one state, with exact derivatives, for any lengths, moduli and losses within ranges. Studies,
tolerances and optimisation use only such models.
"""
