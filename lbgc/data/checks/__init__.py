"""The checks that a log's recordings must pass before any result is computed from them."""
