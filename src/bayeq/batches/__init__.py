"""`batch`: the equations of many files (`run`), the table of coefficients over files and their drift (`result`)."""
