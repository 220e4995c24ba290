"""Algorithms of the source paper (Acevedo-Espinosa et al., RP-UEIS) as printed, to be compared with."""
