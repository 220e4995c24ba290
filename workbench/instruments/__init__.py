"""The two bench instruments, what they say on the wire, and a simulated bench that says the same."""
