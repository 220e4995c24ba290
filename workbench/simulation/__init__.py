"""A chip in one of its states, from its files to spectrum, figures, fields and traps."""
