"""From a file that nobody prepared to columns, units and an even clock."""
