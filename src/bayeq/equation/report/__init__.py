"""The report: one self-contained HTML page with the answer, its pictures and the command that repeats it."""
