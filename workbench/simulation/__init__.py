"""Simulation of a chip in one of its states."""
