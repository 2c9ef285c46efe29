"""Recordings (records), the store of datasets, the logs that become records, and windows cut from
records."""
