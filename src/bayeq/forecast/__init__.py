"""Free runs of equations of motion: their bands, their errors over records, and what is written of them."""
