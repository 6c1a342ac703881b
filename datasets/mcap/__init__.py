"""MCAP files: the table of topics, the CDR layout, readers, writers, and the store of recordings."""
