"""Statistics of records that are read some rows at a time: sums over units of rows."""
