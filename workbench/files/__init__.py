"""Input files of users, errors for mistakes in them, and atomic writing.

The lowest layer: materials, geometry and the other packages of the workbench import it, and it imports none of them.
"""
