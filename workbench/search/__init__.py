"""Search: constrained least squares, continuation, several starts, distinct optima."""
