"""The fit of a noise model to a resting recording: its terms, their sizes, and their intervals."""
