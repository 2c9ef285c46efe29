"""Readers that find columns, units and an even clock in a log file of any layout."""
