"""`batch`: the equations of many files (`run`), the table over them and what has drifted (`result`)."""
