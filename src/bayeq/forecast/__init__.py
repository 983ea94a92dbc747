"""Free runs of equations of motion: bands, errors over records, tables and figures."""
