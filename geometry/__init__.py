"""Shapes: a chip described in words and millimetres, its axisymmetric section, its mesh, its solids.

A chip knows a material only as a name; this package imports neither ``materials`` nor ``workbench``.
"""
