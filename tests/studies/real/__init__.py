"""The parts of `make study-realworld`."""
