"""What is in a record or a file: `info`, before anything is inferred.

info       how it is made, what was noticed, one command for several files
contents   the summary, `RecordInfo`, as text, HTML and plain data; the command to run next
rows       which column is time, which counts experiments, where one ends; spikes, stuck and clipped stretches
channels   numbers and spectrum of each channel
links      which channel is the derivative of another, a first-order state, the drive of a motion
roles      which channel is displacement, velocity, acceleration, force
"""
