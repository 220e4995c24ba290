"""Input files of users, the errors that answer mistakes in them, and files written whole or not at all.

The lowest layer: materials, geometry and the rest of the workbench stand on it, and it imports none of them.
"""
