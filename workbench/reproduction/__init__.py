"""Algorithms of the source paper (Acevedo-Espinosa et al., RP-UEIS), for comparison."""
