"""Statistical studies behind the tables of the documentation; run them from a checkout, `python -m studies.NAME`."""
