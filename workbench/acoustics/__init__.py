"""Fields of a solution, and their effect on particles."""
