"""The two bench instruments, their commands and replies on the wire, and a simulated bench with the same ones."""
