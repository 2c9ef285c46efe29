"""Readers of binary formats: each turns a file into named tables, whose columns are read when they
are asked for."""
