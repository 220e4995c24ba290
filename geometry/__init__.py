"""A chip in words and millimetres, its section, mesh and solids.

A chip knows materials only by name; this package imports neither ``materials`` nor ``workbench``.
"""
