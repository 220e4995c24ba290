"""Fields of a solution, and what they do to particles."""
