"""A campaign of recordings of one device in several states, as its file gives it, and what is known before."""
