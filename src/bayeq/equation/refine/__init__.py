"""Output error: coefficients whose free runs are closest to the measured channels.

output_error  the likelihood of the records with exact inputs and no discrepancy; constraints on the parameters
refine        the work of `Equations.refine`: posteriors by output error, kept unless their free runs are worse
"""
