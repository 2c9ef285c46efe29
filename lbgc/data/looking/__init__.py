"""The log doctor: what a file that nobody prepared is, by its names and by its values."""
