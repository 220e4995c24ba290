"""A campaign: recordings of one device in several states, with its priors."""
