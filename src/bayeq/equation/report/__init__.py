"""The report: one HTML page with the answer, its pictures and how to get it again, which loads nothing."""
