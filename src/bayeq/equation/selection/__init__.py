"""Which terms an equation shows; posterior inclusion probabilities are left as they are."""
