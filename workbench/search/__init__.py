"""One search: least squares under conditions, continuation through easier problems, several starts, distinct optima."""
