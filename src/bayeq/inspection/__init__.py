"""What is in a record or a file: `info`, before anything is inferred."""
