"""Equations of motion that are run: free runs and their bands, scores, output error, physical parameters.

dynamics      equations as one first-order system on a tape
integrate     compiled Runge-Kutta steps; inputs between their samples
tangent       the same with derivatives by initial state and parameters
free_run      a free run with a step that suits it; the band of many
rows          what is known of a record's rows: states, targets, inputs, samples
run           `Forecast`: what `Equations.simulate` returns
score         errors of the single step and of the free run
measured      what free runs are fitted to
shooting      least squares of runs of segments
innovations   runs that are led along the record, where unseen forces drive it away
noise         levels of noise by maximum likelihood
output_error  how long segments are, and what is known in the end
refine        posteriors by output error: what `Equations.refine` puts into the equations
results       what is kept of scores and refinements
write         free runs as files
physical      mass, damping, stiffness ... of an oscillator; physical_units: their units
"""
