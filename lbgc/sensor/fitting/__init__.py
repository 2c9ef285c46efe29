"""From a resting recording to its noise: which terms, how large, and how surely."""
