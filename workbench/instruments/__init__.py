"""The two bench instruments, and a simulated bench with the same commands."""
