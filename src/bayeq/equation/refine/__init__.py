"""Output error: coefficients whose free runs are closest to the measured channels.

output_error  the likelihood of the records with exact inputs and no discrepancy; what is known of the parameters
refine        posteriors by output error, unless their runs are worse: what `Equations.refine` puts into equations
"""
