"""`info`: summary of a record or a file before inference."""
