"""Acoustofluidic chip workbench: simulate a chip, compare it with a recording, say what differs.

Data flows one way: ``Chip -> Section -> SectionMesh -> Problem -> Operators -> Solution -> Spectrum | Fields -> Figures
-> Comparison``. Each stage takes a frozen value and returns one; nothing heavier than definitions happens at import.
"""
