"""Monte Carlo campaigns, the paper's section 4.1 and benchmarks of others: stopped, continued and shown at will."""
