"""Long work: how it is interrupted, and how it runs beside other work."""
