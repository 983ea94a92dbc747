"""Long work that goes on where it was stopped: results in an SQLite file, and worker processes."""
