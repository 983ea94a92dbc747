"""Output error: coefficients whose free runs are closest to the measured channels.

measured      what free runs are fitted to
known         equations between parameters, and signs
shooting      least squares of the runs of segments
output_error  how long segments are, and how well the parameters are known
refine        posteriors by output error, unless their runs are worse: what `Equations.refine` puts into equations
results       what equations keep of it
"""
